// NEON versions of the lines of glow.h, eight pixels at a time.
#pragma once

#include "image/glow.h"
#include "image/lanes_neon.h"

namespace ruffini {

inline void glow_row_neon(const GlowRow& row) {
  int x = 0;
  for (; x + 8 <= row.width; x += 8) {
    const uint8x8x3_t levels = vld3_u8(row.pixels + ptrdiff_t{3} * x);
    int16x8_t sum = vdupq_n_s16(0);
    for (int c = 0; c < 3; ++c) {
      const int16x8_t level = vreinterpretq_s16_u16(vmovl_u8(levels.val[c]));
      sum = vmlaq_n_s16(sum, level, row.weight[static_cast<size_t>(c)]);
    }
    vst1q_s16(row.glow + x, vsubq_s16(vshlq_n_s16(sum, 2), vld1q_s16(row.base + x)));
  }
  glow_row_scalar(row, x);
}

inline void smooth_line_neon(const SmoothLine& line) {
  int x = 0;
  for (; x + 8 <= line.width; x += 8) {
    int16x8_t sum = vqrdmulhq_n_s16(vld1q_s16(line.in[kSmoothReach] + x), kSmoothTap[0]);
    for (size_t k = 1; k <= kSmoothReach; ++k) {
      const int16x8_t pair =
          vaddq_s16(vld1q_s16(line.in[kSmoothReach - k] + x), vld1q_s16(line.in[kSmoothReach + k] + x));
      sum = vaddq_s16(sum, vqrdmulhq_n_s16(pair, kSmoothTap[k]));
    }
    vst1q_s16(line.out + x, sum);
  }
  smooth_line_scalar(line, x);
}

}  // namespace ruffini
