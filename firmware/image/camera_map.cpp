#include "image/camera_map.h"

#include <utility>

namespace ruffini {

Result<BoardSettings> pinhole_board(const Calibration& calibration, const BoardSettings& board) {
  const auto focal = calibration.integer("camera.focal_mpx", 10'000, 80'000'000);
  if (!focal) return focal.error();
  const auto standoff = calibration.integer("camera.standoff_um", 1'000, 2'000'000);
  if (!standoff) return standoff.error();
  BoardSettings ideal = board;
  ideal.camera.focal_mpx = focal.value();
  ideal.camera.standoff_um = standoff.value();
  return ideal;
}

Result<CameraMap> CameraMap::load(const Calibration& calibration, const BoardSettings& board) {
  const auto shift = calibration.integer("camera.step_log2", 0, RayTable::kMaxShift);
  if (!shift) return shift.error();
  auto ideal = pinhole_board(calibration, board);
  if (!ideal) return ideal.error();
  CameraMap map;
  map.ideal_ = std::move(ideal).value();
  const GridSize size_px{board.camera.width_px, board.camera.height_px};
  const int step_log2 = static_cast<int>(shift.value());
  const GridSize lattice = RayTable::lattice_of(size_px, step_log2);
  const auto rays = calibration.tensor("camera.rays", Tensor::Type::kI32, {lattice.n_y, lattice.n_x, 4});
  if (!rays) return rays.error();
  auto table = RayTable::load(rays.value()->as<int32_t>(), size_px, step_log2, "camera.rays");
  if (!table) return table.error();
  map.rays_ = std::move(table).value();
  return map;
}

}  // namespace ruffini
