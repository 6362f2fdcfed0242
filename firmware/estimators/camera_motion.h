// Whether the camera has moved against the pad: what no load on a bonded pad leaves at all of its sides.
//
// At two nodes of each side, a quarter from its ends and kFromBorder from the border, r is what the second pass's forces leave unexplained, in
// standard deviations (solve/support_solver.h). Means of the left, right, upper and lower side, out of the picture's
// middle along (n, t):
//   shift x, y   r_x, r_y of the four sides        zoom   r . n        turn   r . t
// Of each of these four the second smallest counts where at least three sides agree in sign, else 0: a contact that the
// model does not fit spoils one side, and its border the next. With F = |F_x| + |F_y| + |F_z| in newtons, moved is
//   |shift| or |turn| > kMoved + kMovedPerN F,    |zoom| > kZoomed + kZoomedPerN F
//   |r_x| or |r_y| of any side > kTorn + kTornPerN F: a part of the picture has moved, or markers are taken for others
//   touched: both nodes of three sides. Forces there explain any motion; nor does a plate as large as
//            the pad show how deep it presses
//
// Presses on the twin, 3 % off in each material number and up to 6 N, leave 12, 2.5 and 17 at most; a shift by 0.3 px makes 14 to 35,
// a turn by 0.3 degrees 34 to 59. A zoom by 1 % makes 8 to 50, as the forces themselves explain much of it: with a broad contact,
// one below that may go unseen. Creep that estimators/zero_follower.h takes off counts as no motion.
// Frame thread; no allocation after the constructor. Not in the papers.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "estimators/wrench.h"

namespace ruffini {

class CameraMotion {
 public:
  explicit CameraMotion(GridSize nodes);

  // Of which r is needed; none: too few nodes to tell.
  [[nodiscard]] std::span<const uint32_t> unknowns() const { return unknowns_; }
  // `residual`: r of unknowns(), 1/64 standard deviation. `mask`: not 0 where touched, of all nodes.
  [[nodiscard]] bool is_moved(std::span<const int32_t> residual, std::span<const uint8_t> mask,
                              const Wrench& wrench) const;

 private:
  static constexpr size_t kPerSide = 2;
  static constexpr int kFromBorder = 2;
  static constexpr int kLeast = 12;  // nodes along each axis

  std::vector<uint32_t> unknowns_;  // x and y of each node: left, right, upper, lower side
};

}  // namespace ruffini
