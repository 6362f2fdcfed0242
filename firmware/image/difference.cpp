#include "image/difference.h"

#include <algorithm>

#include "image/kernels.h"

namespace ruffini {

ExposureCounts difference_row_scalar(const DifferenceRow& row, int first) {
  ExposureCounts counts;
  for (int x = first; x < row.width; ++x) {
    const uint8_t* pixel = row.pixels + ptrdiff_t{3} * x;
    const uint8_t most = std::max({pixel[0], pixel[1], pixel[2]});
    counts.dark += static_cast<int>(most < kDarkLevel);
    counts.full += static_cast<int>(most == 255);
    row.grey[x] = static_cast<uint16_t>(12 * (pixel[0] + 2 * pixel[1] + pixel[2]));
    for (int c = 0; c < 3; ++c) {
      const ptrdiff_t at = c * row.plane + x;
      const int32_t moved8 = 128 * pixel[c] - row.rest8[at];
      row.change[at] = static_cast<int16_t>((moved8 * row.reciprocal[at] + (1 << 14)) >> 15);
    }
  }
  return counts;
}

ExposureCounts difference(DifferenceRun run, const FrameView& frame, const Rest& rest, std::span<RelativeChange> change,
                          std::span<uint16_t> grey) {
  static_assert(sizeof(RelativeChange) == sizeof(int16_t));
  auto* raw_change = reinterpret_cast<int16_t*>(change.data());
  ExposureCounts counts;
  for (int y = 0; y < frame.height; ++y) {
    const ptrdiff_t at = ptrdiff_t{y} * frame.width;
    const ExposureCounts row = run({.pixels = frame.row(y),
                                    .width = frame.width,
                                    .rest8 = rest.planes8().data() + at,
                                    .reciprocal = rest.reciprocal().data() + at,
                                    .plane = ptrdiff_t{frame.width} * frame.height,
                                    .change = raw_change + at,
                                    .grey = grey.data() + at});
    counts.dark += row.dark;
    counts.full += row.full;
  }
  return counts;
}

ExposureCounts difference(const FrameView& frame, const Rest& rest, std::span<RelativeChange> change,
                          std::span<uint16_t> grey) {
  return difference(kernels::fastest_supported().difference, frame, rest, change, grey);
}

}  // namespace ruffini
