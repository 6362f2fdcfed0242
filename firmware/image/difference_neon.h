// NEON version of a row of difference.h, sixteen pixels at a time.
#pragma once

#include <algorithm>

#include "image/difference.h"
#include "image/lanes_neon.h"

namespace ruffini {

inline ExposureCounts difference_row_neon(const DifferenceRow& given) {
  constexpr int kCount = 16;
  constexpr int kMostPixels = 255 * kCount;  // until an 8-bit count is full
  const DifferenceRow row = given;           // a copy that no store can change stays in registers
  ExposureCounts counts;
  const auto grey = [&](uint8x8_t b, uint8x8_t g, uint8x8_t r) {
    return vaddq_u16(vmulq_n_u16(vaddl_u8(b, r), 12), vmulq_n_u16(vmovl_u8(g), 24));
  };
  const auto change = [&](uint8x8_t level, ptrdiff_t at) {
    const int16x8_t level128 = vreinterpretq_s16_u16(vshll_n_u8(level, 7));
    const int16x8_t moved8 = vsubq_s16(level128, vld1q_s16(row.rest8 + at));
    vst1q_s16(row.change + at, vqrdmulhq_s16(moved8, vld1q_s16(row.reciprocal + at)));
  };
  int x = 0;
  while (x + kCount <= row.width) {
    const int end = std::min(x + kMostPixels, row.width);
    uint8x16_t n_dark = vdupq_n_u8(0);
    uint8x16_t n_full = vdupq_n_u8(0);
    for (; x + kCount <= end; x += kCount) {
      const uint8x16x3_t levels = vld3q_u8(row.pixels + ptrdiff_t{3} * x);
      const uint8x16_t most = vmaxq_u8(vmaxq_u8(levels.val[0], levels.val[1]), levels.val[2]);
      n_dark = vsubq_u8(n_dark, vcltq_u8(most, vdupq_n_u8(kDarkLevel)));  // minus all ones
      n_full = vsubq_u8(n_full, vceqq_u8(most, vdupq_n_u8(255)));
      vst1q_u16(row.grey + x, grey(vget_low_u8(levels.val[0]), vget_low_u8(levels.val[1]), vget_low_u8(levels.val[2])));
      vst1q_u16(row.grey + x + 8,
                grey(vget_high_u8(levels.val[0]), vget_high_u8(levels.val[1]), vget_high_u8(levels.val[2])));
      for (int c = 0; c < 3; ++c) {
        change(vget_low_u8(levels.val[c]), c * row.plane + x);
        change(vget_high_u8(levels.val[c]), c * row.plane + x + 8);
      }
    }
    counts.dark += vaddlvq_u8(n_dark);
    counts.full += vaddlvq_u8(n_full);
  }
  const ExposureCounts rest = difference_row_scalar(row, x);
  return {counts.dark + rest.dark, counts.full + rest.full};
}

}  // namespace ruffini
