#include "image/views.h"

#include <algorithm>
#include <cstdlib>
#include <utility>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int64_t kMinAngle2 = int64_t{1} << 24;  // of slopes Q20: 0.004, a baseline of 1/256 of the distance

}  // namespace

Result<ViewMaps> ViewMaps::load(const Calibration& calibration, const BoardSettings& board) {
  const auto bad = [](const std::string& what) {
    return Error{ErrorKind::kBadInput,
                 "calibration file: views.rays " + what + ": make it again with `ruffini cal fit --only camera`"};
  };
  const auto shift = calibration.integer("views.step_log2", 0, RayTable::kMaxShift);
  if (!shift) return shift.error();
  const Tensor* rays = calibration.tensor("views.rays");
  if (rays == nullptr || rays->type != Tensor::Type::kI32 || rays->shape.size() != 4) return bad("is not there");
  const int64_t n = rays->shape[0];
  if (n < 2 || n > kMaxViews || board.camera.width_px % n != 0) return bad("does not divide the frame's width");
  ViewMaps maps;
  maps.width_px_ = board.camera.width_px / static_cast<int>(n);
  const GridSize size_px{maps.width_px_, board.camera.height_px};
  const GridSize lattice = RayTable::lattice_of(size_px, static_cast<int>(shift.value()));
  if (rays->shape != std::vector<int64_t>{n, lattice.n_y, lattice.n_x, 4})
    return bad("has another shape than the frame");
  const auto values = rays->as<int32_t>();
  const size_t n_values = values.size() / static_cast<size_t>(n);
  for (size_t view = 0; view < static_cast<size_t>(n); ++view) {
    auto table = RayTable::load(values.subspan(view * n_values, n_values), size_px, static_cast<int>(shift.value()),
                                "views.rays");
    if (!table) return table.error();
    maps.views_.push_back(std::move(table).value());
  }
  return maps;
}

PadRay ViewMaps::at(size_t view, int64_t px_x_q16, int64_t px_y_q16) const {
  const int64_t left_q16 = static_cast<int64_t>(view) * width_px_ << 16;
  return views_[view].at(px_x_q16 - left_q16, px_y_q16);
}

RayIntersection triangulate(const PadRay& first, const PadRay& second) {
  const int64_t apart_x = first.x_q8 - second.x_q8;  // within 2^29
  const int64_t apart_y = first.y_q8 - second.y_q8;
  const int64_t turn_x = second.slope_x_q20 - first.slope_x_q20;  // within 2^23
  const int64_t turn_y = second.slope_y_q20 - first.slope_y_q20;
  const int64_t angle2 = turn_x * turn_x + turn_y * turn_y;   // below 2^47
  const int64_t along = turn_x * apart_x + turn_y * apart_y;  // within 2^53
  RayIntersection out;
  if (angle2 < kMinAngle2 || std::abs(along) / angle2 >= ViewMaps::kMaxHeightQ8 >> 20) return out;
  // Computes along 2^20 / angle2 in two steps: 2^8 `along`, below 2^61, then 2^12 times the remainder, below 2^59.
  const int64_t whole = floor_div(along << 8, angle2);
  const int64_t rest = (along << 8) - whole * angle2;
  out.z_q8 = (whole << 12) + floor_div(rest << 12, angle2);
  out.is_found = true;
  const auto place = [&](int64_t a1, int64_t s1, int64_t a2, int64_t s2, int64_t& gap) {
    const int64_t one = a1 + round_shift(s1 * out.z_q8, 20);
    const int64_t other = a2 + round_shift(s2 * out.z_q8, 20);
    gap = std::abs(one - other);
    return round_shift(one + other, 1);
  };
  int64_t gap_x = 0;
  int64_t gap_y = 0;
  out.x_q8 = place(first.x_q8, first.slope_x_q20, second.x_q8, second.slope_x_q20, gap_x);
  out.y_q8 = place(first.y_q8, first.slope_y_q20, second.y_q8, second.slope_y_q20, gap_y);
  out.gap_q8 = std::max(gap_x, gap_y);
  return out;
}

}  // namespace ruffini
