#include "image/marker_hole.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr int kBadQuality = 40;
constexpr int kHole = 4;

}  // namespace

bool has_hole(std::span<const Marker> markers, GridSize size, int width_px, int height_px) {
  if (size.n_x < 4 || size.n_y < 4) return false;
  const auto at = [&](int i, int j) -> const Marker& { return markers[static_cast<size_t>(j * size.n_x + i)]; };
  const auto is_inside = [](int64_t now, int64_t margin, int size_px) {
    return now >= margin && now + margin <= (int64_t{size_px} - 1) << 16;
  };
  const int64_t margin_x = (int64_t{at(size.n_x - 1, 0).rest_x.raw()} - at(0, 0).rest_x.raw()) / (2 * (size.n_x - 1));
  const int64_t margin_y = (int64_t{at(0, size.n_y - 1).rest_y.raw()} - at(0, 0).rest_y.raw()) / (2 * (size.n_y - 1));
  const auto is_bad = [&](int i, int j) {
    const Marker& m = at(i, j);
    if (m.is_absent || (!m.is_lost && m.quality >= kBadQuality)) return false;
    return is_inside(int64_t{m.rest_x.raw()} + m.displacement_x.raw(), margin_x, width_px) &&
           is_inside(int64_t{m.rest_y.raw()} + m.displacement_y.raw(), margin_y, height_px);
  };
  for (int j = 1; j + 1 < size.n_y; ++j) {
    for (int i = 1; i + 1 < size.n_x; ++i) {
      if (!is_bad(i, j)) continue;
      // Checks every 3 x 3 that has this marker in its upper left, centre or right: the first bad one in row order is
      // in the top row.
      for (int left = std::max(i - 2, 1); left <= i; ++left) {
        int n = 0;
        for (int y = j; y <= std::min(j + 2, size.n_y - 2); ++y) {
          for (int x = left; x <= std::min(left + 2, size.n_x - 2); ++x) n += is_bad(x, y) ? 1 : 0;
        }
        if (n >= kHole) return true;
      }
    }
  }
  return false;
}

}  // namespace ruffini
