#if defined(__aarch64__)
#include <arm_neon.h>
#else  // tests run this file on other processors, too
#define SIMDE_ENABLE_NATIVE_ALIASES
#include <simde/arm/neon.h>
#endif

#include "solve/block_kernel.h"

namespace ruffini::block_kernel {
namespace {

template <size_t kN>
struct Neon {
  static void run(Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out) {
    int64x2_t sum[kN];
    for (int64x2_t& s : sum) s = vdupq_n_s64(0);
    for (const uint16_t b : blocks) {
      const int16_t* v = u + size_t{b} * kBlock;
      const int16x8_t u0 = vld1q_s16(v);
      const int16x8_t u1 = vld1q_s16(v + 8);
      const int16x8_t u2 = vld1q_s16(v + 16);
      const int16x8_t u3 = vld1q_s16(v + 24);
      const int16_t* q = table.q + size_t{b} * kN * kBlock;
      const uint8_t* shift = table.shift + size_t{b} * kN;
      for (size_t r = 0; r < kN; ++r) {
        const int16_t* entry = q + r * kBlock;
        __builtin_prefetch(reinterpret_cast<const char*>(entry) + kAheadBytes);
        const int16x8_t a0 = vld1q_s16(entry);
        const int16x8_t a1 = vld1q_s16(entry + 8);
        const int16x8_t a2 = vld1q_s16(entry + 16);
        const int16x8_t a3 = vld1q_s16(entry + 24);
        int32x4_t low = vmull_s16(vget_low_s16(a0), vget_low_s16(u0));  // with `high` eight int32 of four products
        int32x4_t high = vmull_high_s16(a0, u0);
        low = vmlal_s16(low, vget_low_s16(a1), vget_low_s16(u1));
        high = vmlal_high_s16(high, a1, u1);
        low = vmlal_s16(low, vget_low_s16(a2), vget_low_s16(u2));
        high = vmlal_high_s16(high, a2, u2);
        low = vmlal_s16(low, vget_low_s16(a3), vget_low_s16(u3));
        high = vmlal_high_s16(high, a3, u3);
        const int64x2_t wide = vpadalq_s32(vpaddlq_s32(low), high);
        sum[r] = vaddq_s64(sum[r], vshlq_s64(wide, vdupq_n_s64(shift[r])));
      }
    }
    for (size_t r = 0; r < kN; ++r) out[r] = vgetq_lane_s64(sum[r], 0) + vgetq_lane_s64(sum[r], 1);
  }
};

}  // namespace

void rows_neon(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out) {
  dispatch<Neon>(n_rows, table, u, blocks, out);
}

}  // namespace ruffini::block_kernel
