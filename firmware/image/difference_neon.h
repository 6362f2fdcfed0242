// NEON version of a row of difference.h, eight pixels at a time.
#pragma once

#include "image/difference.h"
#include "image/lanes_neon.h"

namespace ruffini {

inline ExposureCounts difference_row_neon(const DifferenceRow& row) {
  ExposureCounts counts;
  int x = 0;
  for (; x + 8 <= row.width; x += 8) {
    const uint8x8x3_t levels = vld3_u8(row.pixels + ptrdiff_t{3} * x);
    uint8x8_t most = vdup_n_u8(0);
    uint16x8_t sum = vdupq_n_u16(0);
    for (int c = 0; c < 3; ++c) {
      most = vmax_u8(most, levels.val[c]);
      sum = c == 1 ? vaddq_u16(sum, vshll_n_u8(levels.val[c], 1)) : vaddw_u8(sum, levels.val[c]);
      const ptrdiff_t i = c * row.plane + x;
      const int16x8_t level128 = vreinterpretq_s16_u16(vshll_n_u8(levels.val[c], 7));
      const int16x8_t moved8 = vsubq_s16(level128, vld1q_s16(row.rest8 + i));
      vst1q_s16(row.change + i, vqrdmulhq_s16(moved8, vld1q_s16(row.reciprocal + i)));
    }
    vst1q_u16(row.grey + x, vmulq_n_u16(sum, 12));
    counts.dark += vaddv_u8(vshr_n_u8(vclt_u8(most, vdup_n_u8(kDarkLevel)), 7));
    counts.full += vaddv_u8(vshr_n_u8(vceq_u8(most, vdup_n_u8(255)), 7));
  }
  const ExposureCounts rest = difference_row_scalar(row, x);
  return {counts.dark + rest.dark, counts.full + rest.full};
}

}  // namespace ruffini
