#include "image/dot_sums.h"

namespace ruffini {

DotSums dot_sums_scalar(const DotWindow& window) {
  for (int row = 0; row < window.side; ++row) {
    const uint8_t* at = window.pixels + row * window.stride;
    int16_t* out = window.luma + ptrdiff_t{row} * window.side;
    for (int x = 0; x < window.side; ++x, at += 3) {
      out[x] = static_cast<int16_t>((117 * at[0] + 601 * at[1] + 306 * at[2] + 32) >> 6);
    }
  }
  const auto between = [](int a, int b, int share) { return a + (((b - a) * share + (1 << 14)) >> 15); };
  DotSums out;
  for (int i = 0; i < window.n_values; ++i) {
    if (window.keep[i] == 0) continue;
    const int16_t* at = window.luma + i;
    const int above = between(at[0], at[1], window.share_x);
    const int below = between(at[window.side], at[window.side + 1], window.share_x);
    const int value = between(above, below, window.share_y);
    out.h_x += window.h_x[i] * value;
    out.h_y += window.h_y[i] * value;
    out.sum += value;
    out.square += value * value;
    out.common += window.t[i] * value;
  }
  return out;
}

}  // namespace ruffini
