// Four lanes of 32-bit integers on NEON; lanes_scalar.h documents each operation.
#pragma once

#if defined(__aarch64__)
#include <arm_neon.h>
#else  // tests compile this file on other processors, too
#define SIMDE_ENABLE_NATIVE_ALIASES
#include <simde/arm/neon.h>
#endif

#include <cstdint>

#include "image/lanes_scalar.h"

namespace ruffini {

struct NeonLanes {
  using V = int32x4_t;
  struct Wide {  // products of lanes 0, 1 and of lanes 2, 3
    int64x2_t low;
    int64x2_t high;
  };
  static constexpr int kCount = 4;

  static V load(const void* at) { return vld1q_s32(static_cast<const int32_t*>(at)); }
  static void store(void* at, V v) { vst1q_s32(static_cast<int32_t*>(at), v); }
  static V load_16(const int16_t* at) { return vmovl_s16(vld1_s16(at)); }
  static void store_16(int16_t* at, V v) { vst1_s16(at, vmovn_s32(v)); }
  static V broadcast(int32_t x) { return vdupq_n_s32(x); }

  static V add(V a, V b) { return vaddq_s32(a, b); }
  static V sub(V a, V b) { return vsubq_s32(a, b); }
  static V min(V a, V b) { return vminq_s32(a, b); }
  static V max(V a, V b) { return vmaxq_s32(a, b); }
  static V abs(V a) { return vabsq_s32(a); }
  static V bit_and(V a, V b) { return vandq_s32(a, b); }
  static V not_equal(V a, V b) { return vaddq_s32(vreinterpretq_s32_u32(vceqq_s32(a, b)), broadcast(1)); }
  template <int kShift>
  static V shift_left(V a) {
    return vshlq_n_s32(a, kShift);
  }
  static V shift_left(V a, int shift) { return vshlq_s32(a, broadcast(shift)); }
  template <int kShift>
  static V shift_right(V a) {
    return vshrq_n_s32(a, kShift);
  }
  static V round_shift_right(V a, int shift) { return vrshlq_s32(a, broadcast(-shift)); }
  static V mul_low(V a, V b) { return vmulq_s32(a, b); }

  template <int kStep>
  static V masked_sum(const int16_t* values, const int16_t* keep) {
    const auto kept = [&](int i) { return vandq_s16(vld1q_s16(values + i), vld1q_s16(keep + i)); };
    if constexpr (kStep == 1) {
      return vandq_s32(load_16(values), load_16(keep));
    } else if constexpr (kStep == 2) {
      return vpaddlq_s16(kept(0));
    } else if constexpr (kStep == 4) {
      return vpaddq_s32(vpaddlq_s16(kept(0)), vpaddlq_s16(kept(8)));
    } else {
      int32_t sums[kCount];
      for (int i = 0; i < kCount; ++i) {
        sums[i] = ScalarLanes::masked_sum<kStep>(values + i * kStep, keep + i * kStep);
      }
      return vld1q_s32(sums);
    }
  }

  static Wide mul(V a, V b) { return {vmull_s32(vget_low_s32(a), vget_low_s32(b)), vmull_high_s32(a, b)}; }
  static Wide scale(V a, int32_t c) { return mul(a, broadcast(c)); }
  static Wide add_wide(Wide a, Wide b) { return {vaddq_s64(a.low, b.low), vaddq_s64(a.high, b.high)}; }
  static Wide sub_wide(Wide a, Wide b) { return {vsubq_s64(a.low, b.low), vsubq_s64(a.high, b.high)}; }
  static Wide add_scaled(Wide sum, V a, int32_t c) {
    return {vmlal_s32(sum.low, vget_low_s32(a), vdup_n_s32(c)), vmlal_high_s32(sum.high, a, broadcast(c))};
  }
  static Wide sub_scaled(Wide sum, V a, int32_t c) {
    return {vmlsl_s32(sum.low, vget_low_s32(a), vdup_n_s32(c)), vmlsl_high_s32(sum.high, a, broadcast(c))};
  }
  static V narrow(Wide sum, int shift) {
    const int64x2_t right = vdupq_n_s64(-shift);
    return vcombine_s32(vmovn_s64(vrshlq_s64(sum.low, right)), vmovn_s64(vrshlq_s64(sum.high, right)));
  }

  template <int kShift>
  static V narrow(Wide sum) {
#if defined(__aarch64__)
    return vrshrn_high_n_s64(vrshrn_n_s64(sum.low, kShift), sum.high, kShift);
#else  // SIMDe has no vrshrn_high
    return vcombine_s32(vrshrn_n_s64(sum.low, kShift), vrshrn_n_s64(sum.high, kShift));
#endif
  }

  static V mul_q31(V a, V b) { return vqrdmulhq_s32(a, b); }

  static V gather(const int32_t* table, V index) {
    const int32_t found[kCount] = {table[vgetq_lane_s32(index, 0)], table[vgetq_lane_s32(index, 1)],
                                   table[vgetq_lane_s32(index, 2)], table[vgetq_lane_s32(index, 3)]};
    return vld1q_s32(found);
  }

  static void gather_pair(const int32_t* table, V index, V& first, V& second) {
    const auto pair = [&](int32_t at) { return vld1_s32(table + at); };
    const int32x4_t a = vcombine_s32(pair(vgetq_lane_s32(index, 0)), pair(vgetq_lane_s32(index, 1)));
    const int32x4_t b = vcombine_s32(pair(vgetq_lane_s32(index, 2)), pair(vgetq_lane_s32(index, 3)));
    first = vuzp1q_s32(a, b);
    second = vuzp2q_s32(a, b);
  }

  // Transposes four vectors.
  static void transpose(V* block) {
    const int64x2_t a = vreinterpretq_s64_s32(vtrn1q_s32(block[0], block[1]));
    const int64x2_t b = vreinterpretq_s64_s32(vtrn2q_s32(block[0], block[1]));
    const int64x2_t c = vreinterpretq_s64_s32(vtrn1q_s32(block[2], block[3]));
    const int64x2_t d = vreinterpretq_s64_s32(vtrn2q_s32(block[2], block[3]));
    block[0] = vreinterpretq_s32_s64(vzip1q_s64(a, c));
    block[1] = vreinterpretq_s32_s64(vzip1q_s64(b, d));
    block[2] = vreinterpretq_s32_s64(vzip2q_s64(a, c));
    block[3] = vreinterpretq_s32_s64(vzip2q_s64(b, d));
  }
  static int64_t sum(V a) { return vaddlvq_s32(a); }
  static int32_t max_lane(V a) { return vmaxvq_s32(a); }
};

}  // namespace ruffini
