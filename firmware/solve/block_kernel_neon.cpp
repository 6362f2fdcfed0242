#if defined(__aarch64__)
#include <arm_neon.h>
#else  // tests run this file on other processors, too
#define SIMDE_ENABLE_NATIVE_ALIASES
#include <simde/arm/neon.h>
#endif

#include "solve/block_kernel.h"

namespace ruffini::block_kernel {

int64_t row_neon(const int16_t* q, const uint8_t* shift, const int16_t* u, std::span<const uint16_t> blocks) {
  int64x2_t sum = vdupq_n_s64(0);
  for (const uint16_t b : blocks) {
    const int16_t* entry = q + size_t{b} * kBlock;
    const int16_t* v = u + size_t{b} * kBlock;
    int32x4_t low = vdupq_n_s32(0);  // with `high` eight int32 of four products
    int32x4_t high = vdupq_n_s32(0);
    for (int i = 0; i < kBlock; i += 8) {
      const int16x8_t a = vld1q_s16(entry + i);
      const int16x8_t c = vld1q_s16(v + i);
      low = vmlal_s16(low, vget_low_s16(a), vget_low_s16(c));
      high = vmlal_high_s16(high, a, c);
    }
    const int64x2_t wide = vpadalq_s32(vpaddlq_s32(low), high);
    sum = vaddq_s64(sum, vshlq_s64(wide, vdupq_n_s64(shift[b])));
  }
  return vgetq_lane_s64(sum, 0) + vgetq_lane_s64(sum, 1);
}

}  // namespace ruffini::block_kernel
