#include "stages/vibration/vibration.h"

#include <algorithm>

#include "base/fixed.h"
#include "base/log2.h"

namespace ruffini {
namespace {

constexpr int64_t kUnitLog2Q16 = 732'032 + (8 << 16);  // of (48 / 1 grey level)^2 (image/difference.h), in Q8
constexpr int64_t kDecibel1e4 = 30'103;                // 10 log10(2)

}  // namespace

Vibration::Vibration(int width_px, int height_px)
    : size_px_{width_px, height_px}, before_(static_cast<size_t>((width_px / kStepPx) * (height_px / kStepPx))) {}

int32_t Vibration::run(std::span<const uint16_t> grey) {
  int64_t sum = 0;
  int64_t squares = 0;
  auto before = before_.begin();
  for (int y = 0; y + kStepPx <= size_px_.n_y; y += kStepPx) {
    for (int x = 0; x + kStepPx <= size_px_.n_x; x += kStepPx) {
      const uint16_t now = grey[static_cast<size_t>(y * size_px_.n_x + x)];
      const int64_t d = int64_t{now} - *before;
      *before++ = now;
      sum += d;
      squares += d * d;
    }
  }
  const auto n = static_cast<int64_t>(before_.size());
  const int64_t mean_q4 = floor_div(16 * sum, n);
  const int64_t variance_q8 = std::max<int64_t>(256 * squares / n - mean_q4 * mean_q4, 1);
  const int64_t above_q16 = log2_q16(static_cast<uint64_t>(variance_q8)) - kUnitLog2Q16;
  return static_cast<int32_t>(floor_div(2 * kDecibel1e4 * above_q16 + (100 << 16), 200 << 16));
}

}  // namespace ruffini
