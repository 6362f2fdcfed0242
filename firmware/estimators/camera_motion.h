// Detects motion of the camera against the pad from a residual pattern that no load on a bonded pad causes at all four
// sides.
//
// r is the residual of the second pass (solve/support_solver.h), in standard deviations, at two nodes of each side: a
// quarter of the side from its ends, kFromBorder nodes from the border. With r averaged over each side, and n and t the
// side's outward normal and tangent:
//   shift x, y   r_x, r_y of the four sides        zoom   r . n        turn   r . t
// Each quantity is what at least three of the four sides agree on (estimators/common_part.h): a contact that the model
// does not fit disturbs one side or, at its border, a second one. With F = |F_x| + |F_y| + |F_z| in newtons, the camera
// counts as moved if any of these holds:
//   |shift| or |turn| > kMoved + kMovedPerN F,    |zoom| > kZoomed + kZoomedPerN F
//   |r_x| or |r_y| of any side > kTorn + kTornPerN F: part of the picture has moved, or markers were mismatched
//   both nodes of three sides are in contact: forces there can explain any motion, and a plate as large as the pad
//            gives no reference for its depth
//
// On the twin, presses of up to 6 N with each material number wrong by 3 % leave at most 12 (shift), 2.5 (zoom) and 17
// (turn). A shift of 0.3 px causes 14 to 35, a turn of 0.3 degrees 34 to 59. A zoom of 1 % causes 8 to 50, because
// forces explain much of it: smaller zooms, and zooms under a broad contact, may stay undetected. Creep removed by
// estimators/zero_follower.h does not count as motion. Frame thread; no allocation after the constructor. Not in the
// papers.
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

  // Unknowns whose residual has_moved needs; empty if the grid has too few nodes.
  [[nodiscard]] std::span<const uint32_t> unknowns() const { return unknowns_; }
  // Returns true if the camera has moved. `residual`: r of unknowns(), in 1/64 standard deviation. `mask`: all nodes,
  // nonzero in contact.
  [[nodiscard]] bool has_moved(std::span<const int32_t> residual, std::span<const uint8_t> mask,
                               const Wrench& wrench) const;

 private:
  static constexpr size_t kPerSide = 2;
  static constexpr int kFromBorder = 2;
  static constexpr int kMinLattice = 12;  // nodes along each axis

  std::vector<uint32_t> unknowns_;  // x and y of each node: left, right, upper, lower side
};

}  // namespace ruffini
