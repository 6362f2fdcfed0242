#include "image/marker_hole.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr int kBadQuality = 40;

// `count` bad markers within side x side.
struct Hole {
  int side = 3;
  int count = 4;
};

}  // namespace

bool has_hole(std::span<const Marker> markers, const MarkerSettings& settings, int width_px, int height_px) {
  const GridSize size = settings.lattice;
  const int64_t pitch_um = std::min(settings.pitch_x_um, settings.pitch_y_um);
  const bool is_wide = pitch_um >= kWidePitchUm;
  const Hole hole = pitch_um < kNarrowPitchUm ? Hole{.side = 5, .count = 10} : Hole{};
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
      if (is_wide && at(i, j).is_lost) {
        const bool is_right_lost = i + 2 < size.n_x && at(i + 1, j).is_lost && is_bad(i + 1, j);
        const bool is_lower_lost = j + 2 < size.n_y && at(i, j + 1).is_lost && is_bad(i, j + 1);
        if (is_right_lost || is_lower_lost) return true;
      }
      // Checks every square with this marker in its top row, where the first bad marker in row order lies.
      for (int left = std::max(i - hole.side + 1, 1); left <= i; ++left) {
        int n = 0;
        for (int y = j; y < std::min(j + hole.side, size.n_y - 1); ++y) {
          for (int x = left; x < std::min(left + hole.side, size.n_x - 1); ++x) n += is_bad(x, y) ? 1 : 0;
        }
        if (n >= hole.count) return true;
      }
    }
  }
  return false;
}

}  // namespace ruffini
