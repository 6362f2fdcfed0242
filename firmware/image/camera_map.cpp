#include "image/camera_map.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr int64_t kMaxPlaceQ8 = int64_t{1} << 28;   // 1 m: at() stays below 2^62
constexpr int64_t kMaxSlopeQ20 = int64_t{1} << 22;  // 76 degrees
constexpr int64_t kMaxShift = 4;

Error bad(const std::string& what) {
  return {ErrorKind::kBadInput, "calibration file: camera." + what + ": make it again with `ruffini cal camera`"};
}

// Lattice lines over n pixels, the last one on or behind the last pixel.
int n_lines(int n_px, int shift) { return ((n_px - 2) >> shift) + 2; }

}  // namespace

Result<CameraMap> CameraMap::load(const Calibration& calibration, const BoardSettings& board) {
  const auto shift = calibration.integer("camera.step_log2", 0, kMaxShift);
  if (!shift) return shift.error();
  const auto focal = calibration.integer("camera.focal_mpx", 10'000, 80'000'000);
  if (!focal) return focal.error();
  const auto standoff = calibration.integer("camera.standoff_um", 1'000, 2'000'000);
  if (!standoff) return standoff.error();
  CameraMap map;
  map.ideal_ = board;
  map.ideal_.camera.focal_mpx = focal.value();
  map.ideal_.camera.standoff_um = standoff.value();
  map.shift_ = static_cast<int>(shift.value());
  map.lattice_ = {n_lines(board.camera.width_px, map.shift_), n_lines(board.camera.height_px, map.shift_)};
  map.cells_ = {board.camera.width_px / board.depth.step_px, board.camera.height_px / board.depth.step_px};
  const auto rays = calibration.tensor("camera.rays", Tensor::Type::kI32, {map.lattice_.n_y, map.lattice_.n_x, 4});
  if (!rays) return rays.error();
  const std::span<const int32_t> values = rays.value()->as<int32_t>();
  for (size_t i = 0; i < values.size(); ++i) {
    const int64_t limit = i % 4 < 2 ? kMaxPlaceQ8 : kMaxSlopeQ20;
    if (values[i] < -limit || values[i] > limit) return bad("rays leads beyond 1 m of pad or 76 degrees");
  }
  map.rays_.assign(values.begin(), values.end());
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

PadRay CameraMap::at(int64_t px_x_q16, int64_t px_y_q16) const {
  const int64_t limit_x = int64_t{ideal_.camera.width_px - 1} << 16;
  const int64_t limit_y = int64_t{ideal_.camera.height_px - 1} << 16;
  const int64_t u = std::clamp<int64_t>(px_x_q16, 0, limit_x) >> shift_;
  const int64_t v = std::clamp<int64_t>(px_y_q16, 0, limit_y) >> shift_;
  const int64_t column = std::min<int64_t>(u >> 16, lattice_.n_x - 2);
  const int64_t row = std::min<int64_t>(v >> 16, lattice_.n_y - 2);
  const int64_t right = u - (column << 16);
  const int64_t below = v - (row << 16);
  const int32_t* upper = rays_.data() + 4 * (row * lattice_.n_x + column);
  const int32_t* lower = upper + ptrdiff_t{4} * lattice_.n_x;
  const auto read = [&](size_t i) {
    const int64_t top = upper[i] * (65'536 - right) + upper[i + 4] * right;
    const int64_t bottom = lower[i] * (65'536 - right) + lower[i + 4] * right;
    return round_shift(top * (65'536 - below) + bottom * below, 32);
  };
  return {read(0), read(1), read(2), read(3)};
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
