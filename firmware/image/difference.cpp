#include "image/difference.h"

namespace ruffini {

ExposureCounts difference(const FrameView& frame, std::span<const uint32_t> reciprocal,
                          std::span<RelativeChange> out, SaturationCounter& saturations) {
  ExposureCounts counts;
  size_t i = 0;
  for (int y = 0; y < frame.height; ++y) {
    const uint8_t* pixel = frame.row(y);
    for (int x = 0; x < frame.width; ++x, pixel += 3) {
      counts.dark += static_cast<int>(pixel[0] < kDarkLevel && pixel[1] < kDarkLevel && pixel[2] < kDarkLevel);
      counts.full += static_cast<int>(pixel[0] == 255 || pixel[1] == 255 || pixel[2] == 255);
      for (int c = 0; c < 3; ++c, ++i) {
        const int64_t ratio = round_shift(int64_t{pixel[c]} * reciprocal[i], 16);
        out[i] = RelativeChange::from_raw(saturate_raw<int16_t>(ratio - 4096, saturations));
      }
    }
  }
  return counts;
}

}  // namespace ruffini
