#include "image/displacement.h"

#include <algorithm>

namespace ruffini {

Displacement::Displacement(const BoardSettings& board, const CameraMap* map)
    : map_(map),
      camera_(board.camera),
      step_px_(board.depth.step_px),
      depth_grid_{camera_.width_px / step_px_, camera_.height_px / step_px_},
      lattice_(board.markers.lattice),
      center_x_q16_(floor_div(camera_.center_x_mpx * 65'536 + 500, 1'000)),
      center_y_q16_(floor_div(camera_.center_y_mpx * 65'536 + 500, 1'000)),
      inverse_focal_q32_(floor_div((int64_t{1} << 32) * 1'000, camera_.focal_mpx)),
      um_to_px_q32_(floor_div(camera_.focal_mpx * (int64_t{1} << 32), camera_.standoff_um * 1'000)),
      pitch_x_q3_(board.markers.pitch_x_um * 8),
      pitch_y_q3_(board.markers.pitch_y_um * 8),
      rest_q3_(static_cast<size_t>(lattice_.count())),
      rest_ray_q8_(rest_q3_.size()),
      lattice_u_(static_cast<size_t>(lattice_.count())) {
  if (lattice_.count() == 0) return;  // a board without [markers]: the stage does not run
  const MarkerSettings& m = board.markers;
  const WindowSettings& w = board.window;
  const NodeRange x = observed_nodes(board.grid.n_x, board.pad.size_x_um, w.min_x_um, w.max_x_um);
  const NodeRange y = observed_nodes(board.grid.n_y, board.pad.size_y_um, w.min_y_um, w.max_y_um);
  nodes_ = {x.count, y.count};
  // Node i of n: X = i size / (n - 1) from the pad's corner.
  const auto from_center_q3 = [](int64_t i, int64_t steps, int64_t size_um) {
    return floor_div(2 * i * size_um * 8 - size_um * steps * 8, 2 * steps);
  };
  const auto on_lattice_q16 = [](int64_t i, int64_t steps, int64_t size_um, int64_t first_um, int64_t pitch_um) {
    return floor_div((i * size_um - first_um * steps) * 65'536, pitch_um * steps);
  };
  for (int row = y.first; row < y.first + y.count; ++row) {
    for (int column = x.first; column < x.first + x.count; ++column) {
      node_q3_.push_back({from_center_q3(column, board.grid.n_x - 1, board.pad.size_x_um),
                          from_center_q3(row, board.grid.n_y - 1, board.pad.size_y_um)});
      nominal_q16_.push_back(
          {on_lattice_q16(column, board.grid.n_x - 1, board.pad.size_x_um, m.first_x_um, m.pitch_x_um),
           on_lattice_q16(row, board.grid.n_y - 1, board.pad.size_y_um, m.first_y_um, m.pitch_y_um)});
    }
  }
  taps_x_.resize(node_q3_.size());
  taps_y_.resize(node_q3_.size());
}

void Displacement::learn(std::span<const Marker> markers) {
  for (size_t i = 0; i < markers.size(); ++i) {
    if (map_ != nullptr) {
      const PadRay ray = map_->at(markers[i].rest_x.raw(), markers[i].rest_y.raw());
      rest_ray_q8_[i] = {ray.x_q8, ray.y_q8};
      rest_q3_[i] = {round_shift(ray.x_q8, 5), round_shift(ray.y_q8, 5)};
    } else {
      rest_q3_[i] = rest_place(markers[i]);
    }
  }
  for (size_t node = 0; node < node_q3_.size(); ++node) {
    Place at = nominal_q16_[node];
    place_node(node, at);
    for (int round = 0; round < kPlaceRounds; ++round) {
      const auto miss = [&](int64_t wanted, int64_t Place::* axis) {
        return wanted -
               round_shift(interpolate(taps_x_[node], taps_y_[node], [&](size_t i) { return rest_q3_[i].*axis; }), 28);
      };
      at.x += floor_div(miss(node_q3_[node].x, &Place::x) * 65'536, pitch_x_q3_);
      at.y += floor_div(miss(node_q3_[node].y, &Place::y) * 65'536, pitch_y_q3_);
      at = {std::clamp<int64_t>(at.x, -65'536, int64_t{lattice_.n_x} * 65'536),
            std::clamp<int64_t>(at.y, -65'536, int64_t{lattice_.n_y} * 65'536)};
      place_node(node, at);
    }
  }
}

void Displacement::place_node(size_t node, Place at_q16) {
  taps_x_[node] = taps(at_q16.x, lattice_.n_x);
  taps_y_[node] = taps(at_q16.y, lattice_.n_y);
}

template <typename Value>
int64_t Displacement::interpolate(const Taps& tx, const Taps& ty, Value value) const {
  int64_t sum = 0;
  for (size_t j = 0; j < 4; ++j) {
    for (size_t i = 0; i < 4; ++i) {
      sum += ty.weight[j] * tx.weight[i] * value(static_cast<size_t>(ty.line[j] * lattice_.n_x + tx.line[i]));
    }
  }
  return sum;
}

// length / f: from px um in Q19 to micrometres in Q3.
int64_t Displacement::to_pad_q3(int64_t length_um_px_q19) const {
  return round_shift(round_shift(length_um_px_q19, 10) * inverse_focal_q32_, 38);
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

Displacement::Place Displacement::rest_place(const Marker& marker) const {
  return {to_pad_q3((marker.rest_x.raw() - center_x_q16_) * camera_.standoff_um * 8),
          to_pad_q3((marker.rest_y.raw() - center_y_q16_) * camera_.standoff_um * 8)};
}

NodeDisplacement Displacement::by_pinhole(const Marker& m, std::span<const DisplacementUm> depth,
                                          SaturationCounter& saturations) const {
  const int64_t x = int64_t{m.rest_x.raw()} + m.displacement_x.raw();
  const int64_t y = int64_t{m.rest_y.raw()} + m.displacement_y.raw();
  const int64_t uz = read_depth(depth, x, y);
  const auto to_pad = [&](int64_t moved_q16, int64_t from_center_q16) {
    const int64_t wide = moved_q16 * camera_.standoff_um * 8 + from_center_q16 * uz;
    return DisplacementUm::from_raw(saturate_raw<int16_t>(to_pad_q3(wide), saturations));
  };
  return {to_pad(m.displacement_x.raw(), x - center_x_q16_), to_pad(m.displacement_y.raw(), y - center_y_q16_),
          DisplacementUm::from_raw(static_cast<int16_t>(uz))};
}

NodeDisplacement Displacement::by_map(const Marker& m, const Place& rest_q8, std::span<const DisplacementUm> depth,
                                      SaturationCounter& saturations) const {
  const PadRay ray =
      map_->at(int64_t{m.rest_x.raw()} + m.displacement_x.raw(), int64_t{m.rest_y.raw()} + m.displacement_y.raw());
  const auto ideal_q16 = [&](int64_t place_q8, int64_t center_q16) {
    return center_q16 + (place_q8 * um_to_px_q32_ >> 24);
  };
  const int64_t uz = read_depth(depth, ideal_q16(ray.x_q8, center_x_q16_), ideal_q16(ray.y_q8, center_y_q16_));
  const auto to_pad = [&](int64_t moved_q8, int64_t slope_q20) {
    const int64_t u_q3 = round_shift(moved_q8 + round_shift(slope_q20 * uz, 15), 5);
    return DisplacementUm::from_raw(saturate_raw<int16_t>(u_q3, saturations));
  };
  return {to_pad(ray.x_q8 - rest_q8.x, ray.slope_x_q20), to_pad(ray.y_q8 - rest_q8.y, ray.slope_y_q20),
          DisplacementUm::from_raw(static_cast<int16_t>(uz))};
}

void Displacement::markers_to_pad(std::span<const Marker> markers, std::span<const DisplacementUm> depth,
                                  SaturationCounter& saturations) {
  for (size_t i = 0; i < markers.size(); ++i) {
    lattice_u_[i] = map_ != nullptr ? by_map(markers[i], rest_ray_q8_[i], depth, saturations)
                                    : by_pinhole(markers[i], depth, saturations);
  }
}

NodeDisplacement Displacement::at_node(size_t node, std::span<const DisplacementUm> depth,
                                       SaturationCounter& saturations) const {
  const auto read = [&](DisplacementUm NodeDisplacement::* axis) {
    return round_shift(interpolate(taps_x_[node], taps_y_[node], [&](size_t i) { return (lattice_u_[i].*axis).raw(); }),
                       28);
  };
  const int64_t ux = read(&NodeDisplacement::x);
  const int64_t uy = read(&NodeDisplacement::y);
  int64_t uz = read(&NodeDisplacement::z);
  for (int round = 0; round < 2 && !depth.empty(); ++round) {
    const int64_t distance = (camera_.standoff_um * 8 + uz) * 1'000;
    const auto image = [&](int64_t place_q3, int64_t center_q16) {
      return center_q16 + floor_div(place_q3 * camera_.focal_mpx * 65'536, distance);
    };
    uz = read_depth(depth, image(node_q3_[node].x + ux, center_x_q16_), image(node_q3_[node].y + uy, center_y_q16_));
  }
  return {DisplacementUm::from_raw(saturate_raw<int16_t>(ux, saturations)),
          DisplacementUm::from_raw(saturate_raw<int16_t>(uy, saturations)),
          DisplacementUm::from_raw(saturate_raw<int16_t>(uz, saturations))};
}

void Displacement::run(std::span<const Marker> markers, std::span<const DisplacementUm> depth,
                       std::span<NodeDisplacement> out, SaturationCounter& saturations) {
  markers_to_pad(markers, depth, saturations);
  for (size_t node = 0; node < out.size(); ++node) out[node] = at_node(node, depth, saturations);
}

void Displacement::mark_filled(std::span<const Marker> markers, std::span<uint8_t> is_filled) const {
  constexpr int64_t kHalf = int64_t{1} << 27;  // Q28
  const auto size = [](int64_t weight) { return weight < 0 ? -weight : weight; };
  for (size_t node = 0; node < is_filled.size(); ++node) {
    const Taps& tx = taps_x_[node];
    const Taps& ty = taps_y_[node];
    int64_t lost = 0;
    for (size_t j = 0; j < 4; ++j) {
      for (size_t i = 0; i < 4; ++i) {
        const Marker& marker = markers[static_cast<size_t>(ty.line[j] * lattice_.n_x + tx.line[i])];
        if (marker.is_lost) lost += size(ty.weight[j]) * size(tx.weight[i]);
      }
    }
    is_filled[node] = lost >= kHalf ? 1 : 0;
  }
}

}  // namespace ruffini
