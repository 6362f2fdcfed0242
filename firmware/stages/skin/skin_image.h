// Touches in the picture of a glowing skin by the paper's method: undistorted, projected back onto the skin, and
// converted to force by one curve; each step is a table.
//
//   place   table over the image with lines 2^k pixels apart, bilinear between; around a tube x wraps from one end to
//           the other, so the four corners are taken relative to the first one
//   force   F(I) = p1 I^2 + p2 I + p3, I in levels, as a table in steps of kCurveStep quarter levels, linear between;
//           below [contact] threshold_un there is no touch: the paper's p3 is 0.6 N
//   single  one touch, at the brightest pixel;  multi  one per region, at its centre, with its mean brightness
//   auto    as single if at most one region is found, else as multi
//
// Kind `skin` of the calibration, tensors skin.place and skin.curve. Frame thread; no allocation after load().
#pragma once

#include <cstdint>
#include <vector>

#include "base/result.h"
#include "board/settings.h"
#include "core/results.h"
#include "image/glow_regions.h"
#include "store/calibration.h"

namespace ruffini {

class SkinImage {
 public:
  static constexpr int kCurveStep = 16;   // quarter levels
  static constexpr int kCurveSize = 513;  // to 2048 levels

  [[nodiscard]] static Result<SkinImage> load(const Calibration& calibration, const BoardSettings& board);

  [[nodiscard]] SkinTouchList run(const GlowRegions& seen) const;

  // Pressing force of a brightness, uN. Values beyond the table use its ends.
  [[nodiscard]] int64_t force_un(int64_t brightness_q2) const;

 private:
  [[nodiscard]] SkinTouch touch(int64_t px_x_q16, int64_t px_y_q16, int64_t brightness_q2) const;

  CameraSettings camera_;
  SkinMode mode_ = SkinMode::kAuto;
  int64_t round_um_ = 0;  // circumference of a tube; 0 for a skin with two ends
  int64_t threshold_un_ = 0;
  int shift_ = 0;  // log2 of the table's step, pixels
  GridSize lattice_;
  std::vector<int32_t> place_um_;  // [y][x][2]
  std::vector<int32_t> curve_un_;
};

}  // namespace ruffini
