// Detects motion of the camera against the pad by a residual that no load on a bonded pad leaves at all four sides.
//
// r is the residual of the second pass (solve/support_solver.h), in standard deviations, at two nodes of each side: a
// quarter of the side from its ends and kFromBorder nodes from the border. With r averaged over each side, and n and t
// the side's outward normal and tangent:
//   shift x, y   r_x, r_y of the four sides        zoom   r . n        turn   r . t
// Each of these is what three of the four sides have in common (estimators/common_part.h): a contact that the model
// does not fit disturbs one side, and its border the next. With F = |F_x| + |F_y| + |F_z| in newtons, the camera
// counts as moved if
//   |shift| or |turn| > kMoved + kMovedPerN F,    |zoom| > kZoomed + kZoomedPerN F
//   |r_x| or |r_y| of any side > kTorn + kTornPerN F: a part of the picture has moved, or markers were mismatched
//   both nodes of three sides are in contact: forces there explain any motion, and a plate as large as the pad does not
//            show how deep it presses
//
// Presses of up to 6 N on the twin, 3 % off in each material number, leave at most 12 (shift), 2.5 (zoom) and 17 (turn).
// A shift by 0.3 px makes 14 to 35, a turn by 0.3 degrees 34 to 59. A zoom by 1 % makes 8 to 50, since the forces explain
// much of it: below that, and under a broad contact, it may not be detected. Creep that estimators/zero_follower.h
// removes is no motion.
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

  // The unknowns whose residual is needed; empty if the grid has too few nodes.
  [[nodiscard]] std::span<const uint32_t> unknowns() const { return unknowns_; }
  // True if the camera has moved. `residual`: r of unknowns(), 1/64 standard deviation. `mask`: of all nodes, not 0 in
  // contact.
  [[nodiscard]] bool has_moved(std::span<const int32_t> residual, std::span<const uint8_t> mask,
                              const Wrench& wrench) const;

 private:
  static constexpr size_t kPerSide = 2;
  static constexpr int kFromBorder = 2;
  static constexpr int kLeast = 12;  // nodes along each axis

  std::vector<uint32_t> unknowns_;  // x and y of each node: left, right, upper, lower side
};

}  // namespace ruffini
