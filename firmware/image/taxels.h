// Relative brightness of each opening (taxel) of a glowing skin, compensated for changes of the skin's own light.
//
//   change  = 2^12 sum of glow / sum of base over the taxel's pixels, floor; clamped to +-2^15
//   light   = median of all changes: warming or ageing panels; touches light up less than half of the skin
//   ratio   = 2^12 (change - light) / (2^12 + light), floor
//   stray   = mean glow of each patch of the black surroundings, without sign: outside light, or a lower black level;
//           1/64
//             levels, floor
//
// The calibration (kind `skin`) lists the pixels of taxels and patches as runs (first pixel, length, number); patches
// are numbered after the taxels. Not in the paper. Frame thread; no allocation after load().
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/result.h"
#include "board/settings.h"
#include "store/calibration.h"

namespace ruffini {

class Taxels {
 public:
  static constexpr int kMaxTaxels = 4096;
  static constexpr int64_t kOne = 4096;
  static constexpr int64_t kMaxChange = int64_t{1} << 15;

  [[nodiscard]] static Result<Taxels> load(const Calibration& calibration, const BoardSettings& board);

  // Sets the brightness of the untouched picture, in the format of image/glow.h.
  void learn(std::span<const int16_t> base);
  void run(std::span<const int16_t> glow);

  [[nodiscard]] std::span<const int32_t> ratio() const { return ratio_; }
  [[nodiscard]] int64_t light_q12() const { return light_q12_; }
  // Largest stray of a patch.
  [[nodiscard]] int64_t stray_q6() const { return stray_q6_; }
  // Number of taxels darker than half of the others' light: a panel is off, or something is on the lens.
  [[nodiscard]] int n_dark() const { return n_dark_; }
  // Light at rest relative to the calibration, Q12: shows how far the skin has aged.
  [[nodiscard]] int64_t age_q12() const { return age_q12_; }

 private:
  struct Run {
    uint32_t first = 0;
    uint32_t length = 0;
    uint32_t number = 0;
  };
  void sum(std::span<const int16_t> plane);
  [[nodiscard]] int64_t median(std::span<const int32_t> values);

  size_t n_taxels_ = 0;
  std::vector<Run> runs_;
  std::vector<int32_t> sum_;  // of taxels, then of patches
  std::vector<int32_t> n_pixels_;
  std::vector<int32_t> base_;        // sums at rest, at least 1
  std::vector<int32_t> calibrated_;  // of the calibration
  std::vector<int32_t> ratio_;
  std::vector<int32_t> sorted_;
  int64_t light_q12_ = 0;
  int64_t stray_q6_ = 0;
  int64_t age_q12_ = kOne;
  int n_dark_ = 0;
};

}  // namespace ruffini
