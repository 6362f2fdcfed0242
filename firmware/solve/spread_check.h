// Checks whether the computed forces explain the whole load, including broad loads that the second pass cannot resolve.
//
// Rubber under pressure moves sideways. With X, Y a node's position relative to the pad's centre, p = (X, Y, 0), u the
// displacement and f the forces minus the finite-strain part, the linear pad u = C f gives
//
//   seen      = sum p . u               explained = sum q . f,  q = C^T p  (`support.spread`)
//   unexplained if |seen - explained| > 5/2 limit + 1/8 sum |p . u|                                  if a node presses
//                  |seen| > min(limit + 1/8 sum |p . (u - u')|, max(limit, sum |p . u|) / 2)         otherwise
//   limit       `support.spread_limit`
//   presses     ContactMask::is_pressed, and the second pass found a force
//   u'          u at the node opposite the pad's centre; the sum is over pairs: a shift of the whole picture cancels
//
// If no node presses, `explained` is ignored. A plate wider than the pad opens single nodes, and the second pass then
// finds small forces there that spread the surface as the plate does: 0.2 N explained 0.8 N. There is then no
// model error to allow for: noise moves the nodes at random, a load moves all of them outwards. On a twin
// |seen| / sum |p . u| is 0.08 (standard deviation) at rest and 0.6 to 1 under a load of 0.1 N that causes no force.
//
// A punch so wide that its pressure stays below the contact threshold moves the surface around it by many times the
// noise. A plate wider than the pad only comes closer to the camera; perspective shows the same motion, and so does a
// camera that moved. For punches and balls at most 0.08 remains unexplained, for those that overhang the pad's edge
// 0.16 (firmware/DESIGN.md).
//
// If depth is zeroed on the mean of the rim (board.toml [depth] gauge = "margin"), the rim must be at rest. It is not
// if more than an eighth of the rim is pressed. If more than 5/16 of all nodes are touched
// (stages/support/second_pass), too little rim remains: forces are 16 % low to 8 % high, and no sum over the surface
// shows it.
//
// Cost: two sums over the nodes. Frame thread; no allocation after load. Not in the paper.
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
  static constexpr int64_t kPressedHalves = 5;
  static constexpr int32_t kMaxSpread = 1 << 23;
  static constexpr int32_t kMaxForce = 1 << 27;  // steps
  static constexpr int kMaxNodes = 4'096;        // keeps the sums within int64: 3 x 2^12 2^23 2^27 < 2^63

  [[nodiscard]] static Result<SpreadCheck> load(const Calibration& calibration, GridSize nodes,
                                                std::span<const NodePlace> places);

  // `u`: xyz interleaved. `beyond`: finite-strain part of `force`, or empty. `is_pressed`:
  // ContactMask::is_pressed of the linear estimate.
  [[nodiscard]] bool is_explained(std::span<const int16_t> u, std::span<const NodeForce> force,
                                  std::span<const NodeForce> beyond, bool is_pressed) const;

 private:
  [[nodiscard]] int64_t odd_part(std::span<const int16_t> u) const;  // sum |p . (u - u')|

  std::vector<NodePlace> place_;
  std::span<const int32_t> spread_;
  int64_t limit_ = 0;
};

// Returns true if more than an eighth of the outermost nodes exceed a quarter of `threshold_lsb`.
[[nodiscard]] bool is_rim_pressed(GridSize nodes, std::span<const NodeForce> force, int64_t threshold_lsb);

}  // namespace ruffini
