#include "estimators/wrench.h"

#include "base/fixed.h"
#include "solve/block_float.h"

namespace ruffini {

NodeGrid::NodeGrid(const BoardSettings& board)
    : n_(board.grid),
      x_(observed_nodes(n_.n_x, board.pad.size_x_um, board.window.min_x_um, board.window.max_x_um)),
      y_(observed_nodes(n_.n_y, board.pad.size_y_um, board.window.min_y_um, board.window.max_y_um)),
      size_x_um_(board.pad.size_x_um),
      size_y_um_(board.pad.size_y_um) {}

int64_t NodeGrid::scale(int64_t sum, int64_t size_um, int64_t steps) {
  // Splits sum / (2 steps) into quotient and remainder, so that sum size_um may exceed 64 bits.
  const int64_t whole = floor_div(sum, 2 * steps);
  const int64_t rest = sum - whole * 2 * steps;
  return whole * size_um + floor_div(rest * size_um + steps, 2 * steps);
}

int64_t NodeGrid::node_area_um2() const {
  return floor_div(size_x_um_ * size_y_um_, int64_t{n_.n_x - 1} * (n_.n_y - 1));
}

bool NodeGrid::is_window_border(int column, int row) const {
  const auto is_at = [](int line, NodeRange seen, int n_all) {
    return (line == 0 && seen.first > 0) || (line == seen.count - 1 && seen.first + seen.count < n_all);
  };
  return is_at(column, x_, n_.n_x) || is_at(row, y_, n_.n_y);
}

std::vector<NodePlace> NodeGrid::places() const {
  std::vector<NodePlace> out;
  for (int row = 0; row < size().n_y; ++row) {
    for (int column = 0; column < size().n_x; ++column) {
      out.push_back(
          {static_cast<int32_t>(to_um_x(twice_steps_x(column))), static_cast<int32_t>(to_um_y(twice_steps_y(row)))});
    }
  }
  return out;
}

Wrench sum_wrench(const NodeGrid& grid, std::span<const NodeForce> force, int64_t force_lsb_un) {
  int64_t fx = 0;
  int64_t fy = 0;
  int64_t fz = 0;
  int64_t y_fz = 0;
  int64_t x_fz = 0;
  int64_t x_fy = 0;
  int64_t y_fx = 0;
  size_t i = 0;
  for (int row = 0; row < grid.size().n_y; ++row) {
    const int64_t y = grid.twice_steps_y(row);
    for (int column = 0; column < grid.size().n_x; ++column, ++i) {
      const int64_t x = grid.twice_steps_x(column);
      const NodeForce& f = force[i];
      fx += f.x;
      fy += f.y;
      fz += f.z;
      y_fz += y * f.z;
      x_fz += x * f.z;
      x_fy += x * f.y;
      y_fx += y * f.x;
    }
  }
  return {.force_x_un = fx * force_lsb_un,
          .force_y_un = fy * force_lsb_un,
          .force_z_un = fz * force_lsb_un,
          .torque_x_un_um = grid.to_um_y(y_fz * force_lsb_un),
          .torque_y_un_um = -grid.to_um_x(x_fz * force_lsb_un),
          .torque_z_un_um = grid.to_um_x(x_fy * force_lsb_un) - grid.to_um_y(y_fx * force_lsb_un)};
}

void add_displacement_moment(std::span<const NodeForce> force, std::span<const NodeDisplacement> displacement,
                             int64_t force_lsb_un, Wrench& wrench, SaturationCounter& saturations) {
  int64_t x = 0;
  int64_t y = 0;
  int64_t z = 0;
  for (size_t i = 0; i < force.size(); ++i) {  // |sums| < 2^14 nodes 2 2^15 2^31 < 2^62
    const NodeForce& f = force[i];
    const NodeDisplacement& u = displacement[i];
    x += int64_t{u.y.raw()} * f.z - int64_t{u.z.raw()} * f.y;
    y += int64_t{u.z.raw()} * f.x - int64_t{u.x.raw()} * f.z;
    z += int64_t{u.x.raw()} * f.y - int64_t{u.y.raw()} * f.x;
  }
  const int64_t limit = (int64_t{1} << 61) / force_lsb_un;
  const auto gained = [&](int64_t sum) {
    return block_float::clamp_counted(round_shift(sum, DisplacementUm::kFrac), saturations, limit) * force_lsb_un;
  };
  wrench.torque_x_un_um += gained(x);
  wrench.torque_y_un_um += gained(y);
  wrench.torque_z_un_um += gained(z);
}

}  // namespace ruffini
