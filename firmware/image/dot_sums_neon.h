// NEON version of dot_sums.h, eight values at a time.
#pragma once

#include "image/dot_sums.h"
#include "image/lanes_neon.h"

namespace ruffini {

// Luma of the eight pixels that begin at `at`.
inline int16x8_t luma_neon(const uint8_t* at) {
  const uint8x8x3_t bgr = vld3_u8(at);
  const uint16x8_t b = vmovl_u8(bgr.val[0]);
  const uint16x8_t g = vmovl_u8(bgr.val[1]);
  const uint16x8_t r = vmovl_u8(bgr.val[2]);
  const auto luma = [](uint16x4_t blue, uint16x4_t green, uint16x4_t red) {
    return vrshrn_n_u32(vmlal_n_u16(vmlal_n_u16(vmull_n_u16(blue, 117), green, 601), red, 306), 6);
  };
  return vreinterpretq_s16_u16(vcombine_u16(luma(vget_low_u16(b), vget_low_u16(g), vget_low_u16(r)),
                                            luma(vget_high_u16(b), vget_high_u16(g), vget_high_u16(r))));
}

inline DotSums dot_sums_neon(const DotWindow& given) {
  const DotWindow window = given;  // a copy that no store can change stays in registers
  if (window.side < kLumaLanes) return dot_sums_scalar(window);
  make_luma(window, [](const uint8_t* at, int16_t* out) { vst1q_s16(out, luma_neon(at)); });
  struct Total {
    int32x4_t low = vdupq_n_s32(0);
    int32x4_t high = vdupq_n_s32(0);
    void add(int16x8_t a, int16x8_t b) {
      low = vmlal_s16(low, vget_low_s16(a), vget_low_s16(b));
      high = vmlal_high_s16(high, a, b);
    }
    [[nodiscard]] int64_t all() const { return vaddlvq_s32(low) + vaddlvq_s32(high); }
  };
  const auto between = [](int16x8_t a, int16x8_t b, int16_t share) {
    return vaddq_s16(a, vqrdmulhq_n_s16(vsubq_s16(b, a), share));
  };
  Total h_x, h_y, sum, square, common;
  for (int i = 0; i < window.n_values; i += kLumaLanes) {
    const int16_t* at = window.luma + i;
    const int16x8_t above = between(vld1q_s16(at), vld1q_s16(at + 1), window.share_x);
    const int16x8_t below = between(vld1q_s16(at + window.side), vld1q_s16(at + window.side + 1), window.share_x);
    const int16x8_t value = vandq_s16(between(above, below, window.share_y), vld1q_s16(window.keep + i));
    h_x.add(value, vld1q_s16(window.h_x + i));
    h_y.add(value, vld1q_s16(window.h_y + i));
    sum.low = vaddw_s16(sum.low, vget_low_s16(value));
    sum.high = vaddw_high_s16(sum.high, value);
    square.add(value, value);
    common.add(value, vld1q_s16(window.t + i));
  }
  return {.h_x = h_x.all(), .h_y = h_y.all(), .sum = sum.all(), .square = square.all(), .common = common.all()};
}

}  // namespace ruffini
