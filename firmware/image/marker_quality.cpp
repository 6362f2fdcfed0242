#include "image/marker_quality.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr int64_t kHalfError2 = 655;  // (0.1 px)^2, Q16
constexpr int64_t kDoublePercent = 175;
constexpr size_t kFewest = 3;
constexpr int64_t kMinQuality = 9;  // quality at half a pixel

int64_t integer_root(int64_t square) {
  int64_t root = 0;
  for (int64_t bit = int64_t{1} << 30; bit > 0; bit >>= 1) {
    if ((root + bit) * (root + bit) <= square) root += bit;
  }
  return root;
}

// True if the dot's area far exceeds its rest area times the median growth of the known markers around it.
bool is_double(const MarkerGraph& graph, const DotAreas& areas, std::span<const uint8_t> known, size_t marker) {
  std::array<int64_t, MarkerGraph::kMaxNear> growth{};
  size_t n = 0;
  for (const int j : graph.around(marker)) {
    const auto at = static_cast<size_t>(j);
    if (known[at] == 0) continue;
    const int64_t value = (int64_t{areas.now[at]} << 10) / areas.rest[at];
    size_t place = n++;
    for (; place > 0 && growth[place - 1] > value; --place) growth[place] = growth[place - 1];
    growth[place] = value;  // insertion into the sorted list
  }
  const int64_t expected_q10 =
      areas.rest[marker] * (n < kFewest ? 1'024 : std::max<int64_t>(growth[(n - 1) / 2], 1'024));
  return (int64_t{areas.now[marker]} << 10) * 100 > kDoublePercent * expected_q10;
}

// Distance of the marker from the nearest extrapolation through two known neighbours, px; 0 if there is no line.
int64_t off_lines_q8(const MarkerGraph& graph, std::span<const Marker> markers, std::span<const uint8_t> known,
                     size_t marker) {
  const auto moved = [&](int i) {
    const Marker& m = markers[static_cast<size_t>(i)];
    return ImagePoint{m.displacement_x.raw(), m.displacement_y.raw()};
  };
  const ImagePoint found = moved(static_cast<int>(marker));
  int64_t least2 = INT64_MAX;
  for (const MarkerGraph::Line& line : graph.lines(marker)) {
    if (known[static_cast<size_t>(line.near)] == 0 || known[static_cast<size_t>(line.far)] == 0) continue;
    const ImagePoint near = moved(line.near);
    const ImagePoint far = moved(line.far);
    least2 = std::min(least2, distance2(found, {2 * near.x - far.x, 2 * near.y - far.y}));
  }
  return least2 == INT64_MAX ? 0 : integer_root(least2) >> 8;
}

}  // namespace

void set_marker_quality(const MarkerGraph& graph, const DotAreas& areas, std::span<const int64_t> error2_q16,
                        int64_t pitch_q8, std::span<Marker> markers, std::span<uint8_t> known) {
  for (size_t i = 0; i < markers.size(); ++i) {
    Marker& marker = markers[i];
    marker.quality = 0;
    if (known[i] == 0 || is_double(graph, areas, known, i)) continue;
    const int64_t off_q8 = std::max<int64_t>(off_lines_q8(graph, markers, known, i) - pitch_q8 / 4, 0);
    const int64_t error2 = error2_q16[i] + off_q8 * off_q8;
    marker.quality = static_cast<uint8_t>(std::max<int64_t>(255 * kHalfError2 / (kHalfError2 + error2), 1));
  }
  for (size_t i = 0; i < markers.size(); ++i) {
    if (known[i] == 0 || markers[i].quality > kMinQuality) continue;
    markers[i].quality = 0;
    known[i] = 0;
  }
}

}  // namespace ruffini
