#include "image/difference.h"

namespace ruffini {

ExposureCounts difference(const FrameView& frame, std::span<const uint16_t> rest, std::span<const uint32_t> reciprocal,
                          std::span<RelativeChange> out) {
  ExposureCounts counts;
  size_t i = 0;
  for (int y = 0; y < frame.height; ++y) {
    const uint8_t* pixel = frame.row(y);
    for (int x = 0; x < frame.width; ++x, pixel += 3) {
      counts.dark += static_cast<int>(pixel[0] < kDarkLevel && pixel[1] < kDarkLevel && pixel[2] < kDarkLevel);
      counts.full += static_cast<int>(pixel[0] == 255 || pixel[1] == 255 || pixel[2] == 255);
      for (int c = 0; c < 3; ++c, ++i) {
        const int64_t change = int64_t{16} * pixel[c] - rest[i];
        out[i] = RelativeChange::from_raw(static_cast<int16_t>(round_shift(change * reciprocal[i], 20)));
      }
    }
  }
  return counts;
}

}  // namespace ruffini
