// Force and moment of the whole pad: exact integer sums of the transmitted nodal forces.
//
//   force  = lsb sum f
//   moment = sum (X x F) about the undeformed pad centre, z = 0:
//     tx = sum Y fz,  ty = -sum X fz,  tz = sum X fy - sum Y fx
//   X = (2 i - (n_x - 1)) size_x / (2 (n_x - 1)), with i counted over the whole pad's grid; each of the four sums
//   is rounded half up once, in uN um. add_displacement_moment adds the nodes' displacement to X.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "core/results.h"
#include "image/displacement.h"
#include "solve/contact_mask.h"
#include "solve/shear_modes.h"

namespace ruffini {

// Positions of the observed nodes within the pad's grid.
class NodeGrid {
 public:
  explicit NodeGrid(const BoardSettings& board);

  [[nodiscard]] GridSize size() const { return {x_.count, y_.count}; }
  // Position in half steps from the pad's centre: 2 i - (n - 1).
  [[nodiscard]] int64_t twice_steps_x(int column) const { return 2 * (x_.first + column) - (n_.n_x - 1); }
  [[nodiscard]] int64_t twice_steps_y(int row) const { return 2 * (y_.first + row) - (n_.n_y - 1); }
  // Converts a sum of (half steps times a quantity) to micrometres times that quantity, half up.
  [[nodiscard]] int64_t to_um_x(int64_t sum) const { return scale(sum, size_x_um_, n_.n_x - 1); }
  [[nodiscard]] int64_t to_um_y(int64_t sum) const { return scale(sum, size_y_um_, n_.n_y - 1); }
  [[nodiscard]] int64_t node_area_um2() const;
  // True if the node is on the outermost observed line and the pad continues beyond it.
  [[nodiscard]] bool is_window_border(int column, int row) const;
  // Positions of the nodes, in node order. Allocates.
  [[nodiscard]] std::vector<NodePlace> places() const;

 private:
  static int64_t scale(int64_t sum, int64_t size_um, int64_t steps);

  GridSize n_;
  NodeRange x_;
  NodeRange y_;
  int64_t size_x_um_;
  int64_t size_y_um_;
};

[[nodiscard]] Wrench sum_wrench(const NodeGrid& grid, std::span<const NodeForce> force, int64_t force_lsb_un);

// Adds the moment due to the nodes' displacement, sum u x f, for pads at finite strain. Each component is rounded half
// up once and clamped so that it can be added to the sums above; clamping is counted.
void add_displacement_moment(std::span<const NodeForce> force, std::span<const NodeDisplacement> displacement,
                             int64_t force_lsb_un, Wrench& wrench, SaturationCounter& saturations);

}  // namespace ruffini
