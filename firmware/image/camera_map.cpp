#include "image/camera_map.h"

#include <algorithm>
#include <utility>

namespace ruffini {

Result<CameraMap> CameraMap::load(const Calibration& calibration, const BoardSettings& board) {
  const auto shift = calibration.integer("camera.step_log2", 0, RayTable::kMaxShift);
  if (!shift) return shift.error();
  const auto focal = calibration.integer("camera.focal_mpx", 10'000, 80'000'000);
  if (!focal) return focal.error();
  const auto standoff = calibration.integer("camera.standoff_um", 1'000, 2'000'000);
  if (!standoff) return standoff.error();
  CameraMap map;
  map.ideal_ = board;
  map.ideal_.camera.focal_mpx = focal.value();
  map.ideal_.camera.standoff_um = standoff.value();
  map.cells_ = {board.camera.width_px / board.depth.step_px, board.camera.height_px / board.depth.step_px};
  const GridSize size_px{board.camera.width_px, board.camera.height_px};
  const int step_log2 = static_cast<int>(shift.value());
  const GridSize lattice = RayTable::lattice_of(size_px, step_log2);
  const auto rays = calibration.tensor("camera.rays", Tensor::Type::kI32, {lattice.n_y, lattice.n_x, 4});
  if (!rays) return rays.error();
  auto table = RayTable::load(rays.value()->as<int32_t>(), size_px, step_log2, "camera.rays");
  if (!table) return table.error();
  map.rays_ = std::move(table).value();
  const Status sources = map.load_sources(calibration);
  if (!sources) return sources.error();
  return map;
}

Status CameraMap::load_sources(const Calibration& calibration) {
  const auto found = calibration.tensor("camera.source", Tensor::Type::kI32, {cells_.n_y, cells_.n_x, 2});
  if (!found) return found.error();
  const std::span<const int32_t> place = found.value()->as<int32_t>();
  const int step = ideal_.depth.step_px;
  const auto n = static_cast<size_t>(cells_.count());
  sources_.resize(n);
  seen_.resize(n);
  // In cells, Q8; the four cells around a place exist.
  const auto cell_q8 = [&](int64_t px_q16, int n_cells) {
    const int64_t at = floor_div(2 * px_q16 - (step - 1) * int64_t{65'536}, int64_t{512} * step);
    return std::clamp<int64_t>(at, 0, int64_t{n_cells - 1} << 8);
  };
  for (size_t i = 0; i < n; ++i) {
    const int64_t u = cell_q8(place[2 * i], cells_.n_x);
    const int64_t v = cell_q8(place[2 * i + 1], cells_.n_y);
    const int64_t column = std::min<int64_t>(u >> 8, cells_.n_x - 2);
    const int64_t row = std::min<int64_t>(v >> 8, cells_.n_y - 2);
    sources_[i] = {static_cast<uint32_t>(row * cells_.n_x + column), static_cast<uint16_t>(u - (column << 8)),
                   static_cast<uint16_t>(v - (row << 8))};
  }
  return Unit{};
}

void CameraMap::rectify(std::span<CellSlope> slope) {
  std::copy(slope.begin(), slope.end(), seen_.begin());
  const auto below = static_cast<size_t>(cells_.n_x);
  for (size_t i = 0; i < slope.size(); ++i) {
    const Source& source = sources_[i];
    const CellSlope* at = seen_.data() + source.cell;
    const int64_t fx = source.right_q8;
    const int64_t fy = source.below_q8;
    const auto read = [&](Slope CellSlope::* axis) {
      const int64_t top = (at[0].*axis).raw() * (256 - fx) + (at[1].*axis).raw() * fx;
      const int64_t bottom = (at[below].*axis).raw() * (256 - fx) + (at[below + 1].*axis).raw() * fx;
      return Slope::from_raw(static_cast<int16_t>(round_shift(top * (256 - fy) + bottom * fy, 16)));
    };
    slope[i] = {read(&CellSlope::x), read(&CellSlope::y)};
  }
}

}  // namespace ruffini
