#include "image/displacement.h"

#include <algorithm>

namespace ruffini {

Displacement::Displacement(const BoardSettings& board)
    : camera_(board.camera),
      step_px_(board.depth.step_px),
      depth_grid_{camera_.width_px / step_px_, camera_.height_px / step_px_},
      lattice_(board.markers.lattice),
      center_x_q16_(floor_div(camera_.center_x_mpx * 65'536 + 500, 1'000)),
      center_y_q16_(floor_div(camera_.center_y_mpx * 65'536 + 500, 1'000)),
      inverse_focal_q32_(floor_div((int64_t{1} << 32) * 1'000, camera_.focal_mpx)),
      lattice_u_(static_cast<size_t>(lattice_.count())) {
  const auto axis = [](int n_nodes, int64_t size_um, int64_t low_um, int64_t high_um, int64_t first_um,
                       int64_t pitch_um, int n_lines, std::vector<Taps>& taps_out, std::vector<int64_t>& place) {
    const NodeRange range = observed_nodes(n_nodes, size_um, low_um, high_um);
    for (int i = range.first; i < range.first + range.count; ++i) {
      // X = i size / (n - 1) from the corner; place on the lattice (X - first) / pitch.
      const int64_t steps = n_nodes - 1;
      taps_out.push_back(taps(floor_div((i * size_um - first_um * steps) * 65'536, pitch_um * steps), n_lines));
      place.push_back(floor_div(2 * i * size_um * 8 - size_um * steps * 8, 2 * steps));
    }
    return range.count;
  };
  const MarkerSettings& m = board.markers;
  const WindowSettings& w = board.window;
  nodes_.n_x = axis(board.grid.n_x, board.pad.size_x_um, w.min_x_um, w.max_x_um, m.first_x_um, m.pitch_x_um,
                    lattice_.n_x, taps_x_, node_x_q3_);
  nodes_.n_y = axis(board.grid.n_y, board.pad.size_y_um, w.min_y_um, w.max_y_um, m.first_y_um, m.pitch_y_um,
                    lattice_.n_y, taps_y_, node_y_q3_);
}

// Catmull-Rom weights at `position`; lines outside the lattice are extrapolated: u_-1 = 2 u_0 - u_1.
Displacement::Taps Displacement::taps(int64_t position_q16, int n_lines) {
  const int64_t position = std::clamp<int64_t>(position_q16, -65'536, int64_t{n_lines} * 65'536);
  const int base = static_cast<int>(std::clamp<int64_t>(position >> 16, 0, n_lines - 2));
  const int64_t t = (position - (int64_t{base} << 16)) >> 2;  // Q14, beyond [0, 1] outside
  const int64_t one = 16'384;
  Taps out;
  if (t < 0 || t > one) {
    out.line = {base, base + 1, base, base};
    out.weight = {one - t, t, 0, 0};
    return out;
  }
  const int64_t t2 = t * t >> 14;
  const int64_t t3 = t2 * t >> 14;
  const std::array<int64_t, 4> w = {(-t + 2 * t2 - t3) >> 1, (2 * one - 5 * t2 + 3 * t3) >> 1,
                                    (t + 4 * t2 - 3 * t3) >> 1, (t3 - t2) >> 1};
  out.line = {base > 0 ? base - 1 : base, base, base + 1, base + 2 < n_lines ? base + 2 : base + 1};
  out.weight = w;
  if (base == 0) {  // u_-1 = 2 u_0 - u_1
    out.weight = {0, w[1] + 2 * w[0], w[2] - w[0], w[3]};
  }
  if (base + 2 >= n_lines) {  // u_n = 2 u_n-1 - u_n-2
    out.weight[2] += 2 * w[3];
    out.weight[1] -= w[3];
    out.weight[3] = 0;
  }
  // What rounding lost goes to the nearer line, so that a constant stays constant.
  out.weight[t < one / 2 ? 1 : 2] += one - (out.weight[0] + out.weight[1] + out.weight[2] + out.weight[3]);
  return out;
}

// Bilinear reading at an image position, micrometres Q3; beyond the grid the border's value.
int64_t Displacement::read_depth(std::span<const DisplacementUm> depth, int64_t px_x_q16, int64_t px_y_q16) const {
  if (depth.empty()) return 0;
  const auto cell = [&](int64_t px_q16, int n) {
    const int64_t at = floor_div(2 * px_q16 - (step_px_ - 1) * int64_t{65'536}, 2 * step_px_);
    return std::clamp<int64_t>(at, 0, int64_t{n - 1} << 16);
  };
  const int64_t u = cell(px_x_q16, depth_grid_.n_x);
  const int64_t v = cell(px_y_q16, depth_grid_.n_y);
  const int64_t column = std::min<int64_t>(u >> 16, depth_grid_.n_x - 2);
  const int64_t row = std::min<int64_t>(v >> 16, depth_grid_.n_y - 2);
  const int64_t fx = u - (column << 16);
  const int64_t fy = v - (row << 16);
  const DisplacementUm* at = depth.data() + row * depth_grid_.n_x + column;
  const int64_t upper = at[0].raw() * (65'536 - fx) + at[1].raw() * fx;
  const int64_t lower = at[depth_grid_.n_x].raw() * (65'536 - fx) + at[depth_grid_.n_x + 1].raw() * fx;
  return round_shift(upper * (65'536 - fy) + lower * fy, 32);
}

void Displacement::markers_to_pad(std::span<const Marker> markers, std::span<const DisplacementUm> depth,
                                  SaturationCounter& saturations) {
  const auto to_pad = [&](int64_t moved_q16, int64_t from_center_q16, int64_t uz_q3) {
    const int64_t wide = moved_q16 * camera_.standoff_um * 8 + from_center_q16 * uz_q3;  // px um, Q19
    return saturate_raw<int16_t>(round_shift(round_shift(wide, 10) * inverse_focal_q32_, 38), saturations);
  };
  for (size_t i = 0; i < markers.size(); ++i) {
    const Marker& m = markers[i];
    const int64_t x = int64_t{m.rest_x.raw()} + m.displacement_x.raw();
    const int64_t y = int64_t{m.rest_y.raw()} + m.displacement_y.raw();
    const int64_t uz = read_depth(depth, x, y);
    lattice_u_[i] = {DisplacementUm::from_raw(to_pad(m.displacement_x.raw(), x - center_x_q16_, uz)),
                     DisplacementUm::from_raw(to_pad(m.displacement_y.raw(), y - center_y_q16_, uz)),
                     DisplacementUm::from_raw(static_cast<int16_t>(uz))};
  }
}

void Displacement::run(std::span<const Marker> markers, std::span<const DisplacementUm> depth,
                       std::span<NodeDisplacement> out, SaturationCounter& saturations) {
  markers_to_pad(markers, depth, saturations);
  for (int row = 0; row < nodes_.n_y; ++row) {
    const Taps& ty = taps_y_[static_cast<size_t>(row)];
    for (int column = 0; column < nodes_.n_x; ++column) {
      const Taps& tx = taps_x_[static_cast<size_t>(column)];
      int64_t sum[3] = {0, 0, 0};
      for (size_t j = 0; j < 4; ++j) {
        for (size_t i = 0; i < 4; ++i) {
          const int64_t weight = ty.weight[j] * tx.weight[i];
          const NodeDisplacement& u = lattice_u_[static_cast<size_t>(ty.line[j] * lattice_.n_x + tx.line[i])];
          sum[0] += weight * u.x.raw();
          sum[1] += weight * u.y.raw();
          sum[2] += weight * u.z.raw();
        }
      }
      const int64_t ux = round_shift(sum[0], 28);
      const int64_t uy = round_shift(sum[1], 28);
      int64_t uz = round_shift(sum[2], 28);
      for (int round = 0; round < 2 && !depth.empty(); ++round) {
        const int64_t distance = (camera_.standoff_um * 8 + uz) * 1'000;
        const auto image = [&](int64_t place_q3, int64_t center_q16) {
          return center_q16 + floor_div(place_q3 * camera_.focal_mpx * 65'536, distance);
        };
        uz = read_depth(depth, image(node_x_q3_[static_cast<size_t>(column)] + ux, center_x_q16_),
                        image(node_y_q3_[static_cast<size_t>(row)] + uy, center_y_q16_));
      }
      out[static_cast<size_t>(row * nodes_.n_x + column)] = {
          DisplacementUm::from_raw(saturate_raw<int16_t>(ux, saturations)),
          DisplacementUm::from_raw(saturate_raw<int16_t>(uy, saturations)),
          DisplacementUm::from_raw(saturate_raw<int16_t>(uz, saturations))};
    }
  }
}

}  // namespace ruffini
