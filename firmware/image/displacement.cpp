#include "image/displacement.h"

#include <algorithm>

namespace ruffini {

Displacement::Displacement(const BoardSettings& board, const CameraMap* map)
    : map_(map),
      camera_(board.camera),
      step_px_(board.depth.step_px),
      depth_grid_{camera_.width_px / step_px_, camera_.height_px / step_px_},
      nodes_(board),
      center_x_q16_(floor_div(camera_.center_x_mpx * 65'536 + 500, 1'000)),
      center_y_q16_(floor_div(camera_.center_y_mpx * 65'536 + 500, 1'000)),
      inverse_focal_q32_(floor_div((int64_t{1} << 32) * 1'000, camera_.focal_mpx)),
      um_to_px_q32_(floor_div(camera_.focal_mpx * (int64_t{1} << 32), camera_.standoff_um * 1'000)),
      rest_q3_(static_cast<size_t>(board.markers.lattice.count())),
      rest_ray_q8_(rest_q3_.size()),
      marker_u_(rest_q3_.size()),
      least_outlier_q3_(
          FieldRepair::least_q3(board.markers.pitch_x_um, board.markers.pitch_y_um, board.pad.thickness_um)),
      shear_(rest_q3_.size()),
      is_missing_(rest_q3_.size()) {
  if (!board.markers.is_scattered && !rest_q3_.empty()) repair_.emplace(board.markers.lattice);
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
  nodes_.learn(rest_q3_, markers);
}

// Converts length / f from px um in Q19 to micrometres in Q3.
int64_t Displacement::to_pad_q3(int64_t length_um_px_q19) const {
  return round_shift(round_shift(length_um_px_q19, 10) * inverse_focal_q32_, 38);
}

// Reads depth bilinearly at an image position, micrometres Q3; beyond the grid the border's value.
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

PadPoint Displacement::rest_place(const Marker& marker) const {
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

NodeDisplacement Displacement::by_map(const Marker& m, const PadPoint& rest_q8, std::span<const DisplacementUm> depth,
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
    marker_u_[i] = map_ != nullptr ? by_map(markers[i], rest_ray_q8_[i], depth, saturations)
                                   : by_pinhole(markers[i], depth, saturations);
  }
}

// Replaces u_x and u_y of lost markers and outliers by the smoothest continuation of their neighbours. u_z is
// unchanged.
void Displacement::repair(std::span<const Marker> markers, SaturationCounter& saturations) {
  if (!repair_) return;
  for (size_t i = 0; i < markers.size(); ++i) {
    shear_[i] = {marker_u_[i].x.raw(), marker_u_[i].y.raw(), 0};
    is_missing_[i] = markers[i].is_lost ? 1 : 0;
  }
  repair_->run(shear_, is_missing_, least_outlier_q3_);
  for (size_t i = 0; i < markers.size(); ++i) {
    if (is_missing_[i] == 0) continue;
    marker_u_[i].x = DisplacementUm::from_raw(saturate_raw<int16_t>(shear_[i].x, saturations));
    marker_u_[i].y = DisplacementUm::from_raw(saturate_raw<int16_t>(shear_[i].y, saturations));
  }
}

void Displacement::mark_filled(std::span<const Marker> markers, std::span<uint8_t> filled) {
  for (size_t i = 0; i < markers.size(); ++i) {
    if (is_missing_[i] != FieldRepair::kOutlier) is_missing_[i] = markers[i].is_lost ? 1 : 0;
  }
  nodes_.mark_filled(is_missing_, filled);
}

NodeDisplacement Displacement::at_node(size_t node, std::span<const DisplacementUm> depth,
                                       SaturationCounter& saturations) const {
  const auto [ux, uy, uz_of_markers] = nodes_.three_at(node, [&](size_t i) -> std::array<int64_t, 3> {
    const NodeDisplacement& u = marker_u_[i];
    return {u.x.raw(), u.y.raw(), u.z.raw()};
  });
  int64_t uz = uz_of_markers;
  for (int round = 0; round < 2 && !depth.empty(); ++round) {
    const int64_t distance = (camera_.standoff_um * 8 + uz) * 1'000;
    const auto image = [&](int64_t place_q3, int64_t center_q16) {
      return center_q16 + floor_div(place_q3 * camera_.focal_mpx * 65'536, distance);
    };
    uz = read_depth(depth, image(nodes_.place(node).x + ux, center_x_q16_),
                    image(nodes_.place(node).y + uy, center_y_q16_));
  }
  return {DisplacementUm::from_raw(saturate_raw<int16_t>(ux, saturations)),
          DisplacementUm::from_raw(saturate_raw<int16_t>(uy, saturations)),
          DisplacementUm::from_raw(saturate_raw<int16_t>(uz, saturations))};
}

void Displacement::run(std::span<const Marker> markers, std::span<const DisplacementUm> depth,
                       std::span<NodeDisplacement> out, SaturationCounter& saturations) {
  markers_to_pad(markers, depth, saturations);
  repair(markers, saturations);
  for (size_t node = 0; node < out.size(); ++node) out[node] = at_node(node, depth, saturations);
}

}  // namespace ruffini
