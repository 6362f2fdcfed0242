#include "image/ray_table.h"

#include <algorithm>

#include "base/fixed.h"

namespace ruffini {

GridSize RayTable::lattice_of(GridSize size_px, int shift) {
  return {((size_px.n_x - 2) >> shift) + 2, ((size_px.n_y - 2) >> shift) + 2};
}

Result<RayTable> RayTable::load(std::span<const int32_t> rays, GridSize size_px, int shift, const std::string& what) {
  for (size_t i = 0; i < rays.size(); ++i) {
    const int64_t limit = i % 4 < 2 ? kMaxPlaceQ8 : kMaxSlopeQ20;
    if (rays[i] < -limit || rays[i] > limit) {
      return Error{ErrorKind::kBadInput, "calibration file: " + what +
                                             " leads beyond 1 m of pad or 76 degrees: make it again with `ruffini cal "
                                             "camera`"};
    }
  }
  RayTable table;
  table.size_px_ = size_px;
  table.shift_ = shift;
  table.lattice_ = lattice_of(size_px, shift);
  table.rays_.assign(rays.begin(), rays.end());
  return table;
}

PadRay RayTable::at(int64_t px_x_q16, int64_t px_y_q16) const {
  const int64_t limit_x = int64_t{size_px_.n_x - 1} << 16;
  const int64_t limit_y = int64_t{size_px_.n_y - 1} << 16;
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

}  // namespace ruffini
