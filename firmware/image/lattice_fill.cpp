#include "image/lattice_fill.h"

#include <algorithm>

namespace ruffini {

int neighbour_mean(std::span<const Marker> markers, GridSize size, std::span<const uint8_t> known, int index,
                   int64_t& mean_x, int64_t& mean_y) {
  const int x = index % size.n_x;
  const int y = index / size.n_x;
  int count = 0;
  mean_x = mean_y = 0;
  for (int v = std::max(y - 1, 0); v <= std::min(y + 1, size.n_y - 1); ++v) {
    for (int u = std::max(x - 1, 0); u <= std::min(x + 1, size.n_x - 1); ++u) {
      const auto at = static_cast<size_t>(v * size.n_x + u);
      if (known[at] == 0) continue;
      ++count;
      mean_x += markers[at].displacement_x.raw();
      mean_y += markers[at].displacement_y.raw();
    }
  }
  if (count > 0) {
    mean_x = floor_div(mean_x, count);
    mean_y = floor_div(mean_y, count);
  }
  return count;
}

void fill_from_neighbours(std::span<Marker> markers, GridSize size, std::vector<uint8_t>& known,
                          std::vector<uint8_t>& next) {
  for (int ring = 0; ring < size.n_x + size.n_y; ++ring) {
    std::copy(known.begin(), known.end(), next.begin());
    bool is_complete = true;
    for (int i = 0; i < size.count(); ++i) {
      if (known[static_cast<size_t>(i)] != 0) continue;
      int64_t x = 0;
      int64_t y = 0;
      if (neighbour_mean(markers, size, known, i, x, y) == 0) {
        is_complete = false;
        continue;
      }
      Marker& marker = markers[static_cast<size_t>(i)];
      marker.displacement_x = ImagePx::from_raw(static_cast<int32_t>(x));
      marker.displacement_y = ImagePx::from_raw(static_cast<int32_t>(y));
      next[static_cast<size_t>(i)] = 1;
    }
    std::swap(known, next);
    if (is_complete) return;
  }
}

}  // namespace ruffini
