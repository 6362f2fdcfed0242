// Whether the forces of a frame are all that presses: what the second pass cannot see on its own.
//
// Rubber that is pressed gives way to the sides. With X, Y a node's place from the pad's centre, p = (X, Y, 0), u the
// displacement and f the forces less what finite strain adds, of the linear pad u = C f
//
//   seen      = sum p . u               explained = sum q . f,  q = C^T p  (`support.spread`)
//   lost      where |seen - explained| > limit + 1/8 sum |p . u|
//   limit     `support.spread_limit`; three times that where a node presses (ContactMask::is_pressed): a faint touch begins so
//
// A punch so wide that its pressure stays below what counts as a touch moves the surface around it by many times the noise; a
// plate wider than the pad only comes nearer to the camera, which perspective shows as the same motion, and so does a camera
// that moved. Of punches and balls 0.08 remain unexplained at most, 0.16 of those that hang over the pad's edge
// (firmware/DESIGN.md).
//
// Depth whose zero is the mean of the rim (board.toml [depth] gauge = "margin") needs a rim at rest. A pad that is pressed on
// more than an eighth of its rim has none. One that is touched on more than 5/16 of its nodes (stages/support/second_pass) has too
// little: its forces are 16 % low to 8 % high, and no sum over the surface shows it.
//
// Two sums over the nodes. Frame thread; no allocation after load. Not in the paper.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "base/result.h"
#include "solve/contact_mask.h"
#include "solve/shear_modes.h"
#include "store/calibration.h"

namespace ruffini {

class SpreadCheck {
 public:
  static constexpr int64_t kShareQ8 = 32;
  static constexpr int64_t kPressedLimits = 3;
  static constexpr int32_t kMaxSpread = 1 << 23;
  static constexpr int32_t kMaxForce = 1 << 27;  // steps
  static constexpr int kMostNodes = 4'096;       // so that the sums fit: 3 x 2^12 2^23 2^27 < 2^63

  [[nodiscard]] static Result<SpreadCheck> load(const Calibration& calibration, GridSize nodes,
                                                std::span<const NodePlace> places);

  // `u`: xyz interleaved; `beyond`: what finite strain added to `force`, empty without; `is_pressed`: by the linear
  // estimate a node presses (ContactMask::is_pressed).
  [[nodiscard]] bool is_explained(std::span<const int16_t> u, std::span<const NodeForce> force,
                                  std::span<const NodeForce> beyond, bool is_pressed) const;

 private:
  std::vector<NodePlace> place_;
  std::span<const int32_t> spread_;
  int64_t limit_ = 0;
};

// True if more than an eighth of the outermost nodes press harder than a quarter of `threshold_lsb`.
[[nodiscard]] bool is_rim_pressed(GridSize nodes, std::span<const NodeForce> force, int64_t threshold_lsb);

}  // namespace ruffini
