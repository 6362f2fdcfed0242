#include "capture/pixels.h"

#include <algorithm>
#include <cstring>

namespace ruffini {
namespace {

constexpr int kShift = 14;
constexpr int32_t kHalf = 1 << (kShift - 1);

uint8_t level(int32_t q14) { return static_cast<uint8_t>(std::clamp((q14 + kHalf) >> kShift, 0, 255)); }

// Two adjacent pixels share U and V.
void pair_to_bgr(const YuvRule& rule, int y0, int y1, int u, int v, uint8_t* out) {
  const int32_t b = rule.u_to_b * (u - 128);
  const int32_t g = rule.u_to_g * (u - 128) + rule.v_to_g * (v - 128);
  const int32_t r = rule.v_to_r * (v - 128);
  const int32_t light[] = {rule.gain * (y0 - rule.black), rule.gain * (y1 - rule.black)};
  for (int i = 0; i < 2; ++i) {
    out[3 * i] = level(light[i] + b);
    out[3 * i + 1] = level(light[i] + g);
    out[3 * i + 2] = level(light[i] + r);
  }
}

void row_to_bgr(PixelLayout layout, const YuvRule& rule, const uint8_t* row, const uint8_t* uv, int width,
                uint8_t* out) {
  switch (layout) {
    case PixelLayout::kBgr:
      std::memcpy(out, row, static_cast<size_t>(width) * 3);
      return;
    case PixelLayout::kRgb:
      for (int x = 0; x < width; ++x) {
        for (int c = 0; c < 3; ++c) out[3 * x + c] = row[3 * x + 2 - c];
      }
      return;
    case PixelLayout::kBgrx:
      for (int x = 0; x < width; ++x) {
        for (int c = 0; c < 3; ++c) out[3 * x + c] = row[4 * x + c];
      }
      return;
    case PixelLayout::kYuyv:
      for (int x = 0; x < width; x += 2) {
        pair_to_bgr(rule, row[2 * x], row[2 * x + 2], row[2 * x + 1], row[2 * x + 3], out + ptrdiff_t{3} * x);
      }
      return;
    case PixelLayout::kGrey:
      for (int x = 0; x < width; ++x) std::memset(out + ptrdiff_t{3} * x, row[x], 3);
      return;
    case PixelLayout::kNv12:
      for (int x = 0; x < width; x += 2) {
        pair_to_bgr(rule, row[x], row[x + 1], uv[x], uv[x + 1], out + ptrdiff_t{3} * x);
      }
      return;
  }
}

}  // namespace

void to_bgr(PixelLayout layout, const YuvRule& rule, const RawFrame& frame, int width, int height, uint8_t* out) {
  for (int y = 0; y < height; ++y) {
    const uint8_t* uv = layout == PixelLayout::kNv12 ? frame.planes[1] + frame.strides[1] * (y / 2) : nullptr;
    row_to_bgr(layout, rule, frame.planes[0] + frame.strides[0] * y, uv, width, out + ptrdiff_t{3} * width * y);
  }
}

}  // namespace ruffini
