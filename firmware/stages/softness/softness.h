// Estimates the modulus of a squeezed object from the curvature of the dent that it makes in a gel without markers.
//
//   g    = sum over the channels of (d/dx f)^2 + (d/dy f)^2      between four neighbouring cells of the grid of
//                                                                features
//   c    = sqrt(mean of the kBlocks largest g)                   without kRim cells at each edge, where the gel bends
//   x    = mean over the rise of log2 c - q log2 F - r           F: pressing force; q, r: of a rigid object
//   E'   = G 2^x / (1 - 2^x)                                     G: scale of the gel, 2^x: the gel's share of rigid
//
// The light of a cell follows the gel's slope, so that c is the curvature of its dent. Two elastic bodies under one
// pressure (Hertz, K. L. Johnson, Contact Mechanics, 1985, section 4.2) share their approach in inverse proportion to
// their moduli, so that the dent of an object of modulus E' has the part E' / (E' + G) of the curvature of a rigid one
// of its radius. Between objects of unlike shape only the order of magnitude holds. Not in the papers.
//
// The rise: all frames from the lower force on until the upper one is reached for the first time; a release (below half
// of the lower force) before that is no squeeze, nor is a jump from below the lower force beyond the upper one. Frame
// thread; no allocation after load().
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "base/result.h"
#include "core/results.h"
#include "store/calibration.h"

namespace ruffini {

class Softness {
 public:
  static constexpr int kChannels = 3;
  static constexpr int kRim = 2;               // cells
  static constexpr size_t kBlocks = 6;         // mean of so many: a small ball bends no more of them
  static constexpr int64_t kHardest = -9'962;  // log2 of 0.9, Q16: a stiffer object cannot be told from a rigid one

  // Loads kind "softness". Errors: kBadInput, also if the grid has fewer than kBlocks blocks inside its rim.
  [[nodiscard]] static Result<Softness> load(const Calibration& calibration, GridSize cells);

  // `features`: planes of B, G and R, cells by rows, Q16 of rest. The force is that of the gel on the object, uN.
  void run(std::span<const int32_t> features, int64_t force_un, int64_t sigma_un);
  // Call for a frame whose force is not valid: the object may have been released or replaced meanwhile. The next
  // squeeze counts after a release.
  void discard_rise();
  void forget();

  // Of the last squeeze; n_frames 0: none yet.
  [[nodiscard]] const Squeeze& result() const { return result_; }
  // log2 of c^2 + 1, Q16.
  [[nodiscard]] int64_t dent(std::span<const int32_t> features);

 private:
  enum class Phase : uint8_t { kReleased, kRising, kDone };

  [[nodiscard]] int64_t modulus_pa(int64_t log_share) const;
  void finish();

  GridSize cells_;
  int64_t low_un_ = 0;
  int64_t high_un_ = 0;
  int64_t slope_ = 0;  // q, Q16
  int64_t rigid_ = 0;  // r, Q16
  int64_t sigma_ = 0;  // of x between squeezes of one object, Q16
  int64_t gel_pa_ = 0;
  std::vector<int64_t> block_;

  Phase phase_ = Phase::kReleased;
  int64_t n_ = 0;
  int64_t sum_ = 0;           // of log2 c - q log2 F, Q16
  int64_t sum_relative_ = 0;  // of sigma / F, Q16
  Squeeze result_;
};

}  // namespace ruffini
