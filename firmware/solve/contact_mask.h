// Where the pad is touched and how surely, from a field of nodal forces: 0 not, up to 128 (Q7) surely.
//
//   T       = strongest -f_z of the frame / 8, at least `least`, at most the board's threshold
//   pressed = (-f_z - T) / T, clamped to 0..1
//   opened  = largest over the 2 x 2 squares at the node of the smallest pressed in the square
//             (single noisy nodes vanish); zero when fewer than min_nodes are opened
//             of the strongest node also (-f_z - A) / A, clamped to 0..1      A = `alone`
//   mask    = largest opened of the node and its 8 neighbours
//
// `least` and `alone` are what the noise of untouched frames of this unit hardly ever reaches (kind `contact` of
// proto/CALIBRATION.md); without them, and while the light drifts, T is the board's threshold. The eighth: what the linear estimate leaves around a
// strong contact is no second one.
//
// Every step is continuous in the force, so that a node at the threshold cannot flip the second pass.
// Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

// fx, fy, fz of one node in steps of the board's force_lsb_un.
struct NodeForce {
  int32_t x = 0;
  int32_t y = 0;
  int32_t z = 0;
};

class ContactMask {
 public:
  static constexpr int kFraction = 7;
  static constexpr int64_t kFull = int64_t{1} << kFraction;

  // threshold_lsb > 0
  ContactMask(GridSize nodes, int64_t threshold_lsb, int64_t min_nodes);

  // What noise hardly ever reaches, from kind `contact`. Errors: kBadInput.
  Status load_noise(const Calibration& calibration, int64_t force_lsb_un);

  // One value a node; valid until the next call. is_steady: the noise is what it was when it was measured.
  std::span<const uint8_t> find(std::span<const NodeForce> force, bool is_steady = true);
  // T of the last field.
  [[nodiscard]] int64_t threshold_lsb() const { return frame_threshold_lsb_; }

 private:
  GridSize nodes_;
  int64_t threshold_lsb_;
  int64_t min_nodes_;
  int64_t least_lsb_;
  int64_t alone_lsb_ = int64_t{1} << 40;  // beyond any force
  int64_t frame_threshold_lsb_;
  std::vector<uint8_t> pressed_;
  std::vector<uint8_t> opened_;
  std::vector<uint8_t> mask_;
};

}  // namespace ruffini
