#include "image/slope_rectifier.h"

#include <algorithm>

namespace ruffini {

Result<SlopeRectifier> SlopeRectifier::load(const Calibration& calibration, const BoardSettings& board) {
  SlopeRectifier out;
  const int step = board.depth.step_px;
  out.cells_ = {board.camera.width_px / step, board.camera.height_px / step};
  const auto found = calibration.tensor("camera.source", Tensor::Type::kI32, {out.cells_.n_y, out.cells_.n_x, 2});
  if (!found) return found.error();
  const std::span<const int32_t> place = found.value()->as<int32_t>();
  const auto n = static_cast<size_t>(out.cells_.count());
  out.sources_.resize(n);
  out.seen_.resize(n);
  // In cells, Q8. The four cells around a position exist.
  const auto cell_q8 = [&](int64_t px_q16, int n_cells) {
    const int64_t at = floor_div(2 * px_q16 - (step - 1) * int64_t{65'536}, int64_t{512} * step);
    return std::clamp<int64_t>(at, 0, int64_t{n_cells - 1} << 8);
  };
  for (size_t i = 0; i < n; ++i) {
    const int64_t u = cell_q8(place[2 * i], out.cells_.n_x);
    const int64_t v = cell_q8(place[2 * i + 1], out.cells_.n_y);
    const int64_t column = std::min<int64_t>(u >> 8, out.cells_.n_x - 2);
    const int64_t row = std::min<int64_t>(v >> 8, out.cells_.n_y - 2);
    out.sources_[i] = {static_cast<uint32_t>(row * out.cells_.n_x + column), static_cast<uint16_t>(u - (column << 8)),
                       static_cast<uint16_t>(v - (row << 8))};
  }
  return out;
}

void SlopeRectifier::run(std::span<CellSlope> slope) {
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
