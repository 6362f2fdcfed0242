// NEON version of dot_weights.h, eight pixels at a time. Bounds beside those of dot_weights.h: a threshold is below
// 12,240 2^16 / 2^15, so background, grey and threshold fit 16 bits without a sign, and rows differ by less than 2^15.
// The background is (floor(box inverse / 2^31) + 1) >> 1, which is (box inverse + 2^31) >> 32.
#pragma once

#include "image/dot_weights.h"
#include "image/lanes_neon.h"

namespace ruffini {

class DotWeightsNeon {
 public:
  static void run(const DotRow& row) {
    const int whole = row.width / kCount * kCount;
    const uint32_t sum = add_up(row, whole);
    DotWeights<ScalarLanes>::finish(row, whole, sum);
    row.is_light ? weigh<true>(row, whole) : weigh<false>(row, whole);
    DotWeights<ScalarLanes>::finish_weights(row, whole);
  }

 private:
  static constexpr int kCount = DotTiles::kSide;
  static_assert(kCount == 8);

  static int32x4_t prefix_sums(int32x4_t v) {
    const int32x4_t zero = vdupq_n_s32(0);
    v = vaddq_s32(v, vextq_s32(zero, v, 3));
    return vaddq_s32(v, vextq_s32(zero, v, 2));
  }

  // Moves the boxes by a row and adds up their columns. Returns the sum of all.
  static uint32_t add_up(const DotRow& given, int whole) {
    const DotRow row = given;  // a copy that no store can change stays in registers
    int32_t* const sums = row.prefix_sum + row.box_radius_px + 1;
    int32x4_t so_far = vdupq_n_s32(0);
    for (int x = 0; x < whole; x += kCount) {
      const int16x8_t moved = vreinterpretq_s16_u16(vsubq_u16(vld1q_u16(row.entering + x), vld1q_u16(row.leaving + x)));
      const int32x4_t low = vaddw_s16(vld1q_s32(row.column_sum + x), vget_low_s16(moved));
      const int32x4_t high = vaddw_s16(vld1q_s32(row.column_sum + x + 4), vget_high_s16(moved));
      vst1q_s32(row.column_sum + x, low);
      vst1q_s32(row.column_sum + x + 4, high);
      const int32x4_t low_sums = vaddq_s32(prefix_sums(low), so_far);
      const int32x4_t high_sums = vaddq_s32(prefix_sums(high), vdupq_laneq_s32(low_sums, 3));
      so_far = vdupq_laneq_s32(high_sums, 3);
      vst1q_s32(sums + x, low_sums);
      vst1q_s32(sums + x + 4, high_sums);
    }
    return static_cast<uint32_t>(vgetq_lane_s32(so_far, 0));
  }

  template <bool kIsLight>
  static void weigh(const DotRow& given, int whole) {
    const DotRow row = given;
    const int32_t* const high = row.prefix_sum + 2 * row.box_radius_px + 1;
    const uint16x4_t threshold_q15 = vdup_n_u16(static_cast<uint16_t>(row.threshold_q15));
    const auto background = [&](int x) {
      const int32x4_t box = vsubq_s32(vld1q_s32(high + x), vld1q_s32(row.prefix_sum + x));
      const int32x4_t twice = vqdmulhq_s32(box, vld1q_s32(row.inverse_q32 + x));
      return vrshrn_n_u32(vreinterpretq_u32_s32(twice), 1);
    };
    const auto below = [&](uint16x4_t level) { return vshrn_n_u32(vmull_u16(level, threshold_q15), 15); };
    for (int x = 0; x < whole; x += kCount) {
      if (row.open[x / kCount] == 0) {
        vst1q_s16(row.weight + x, vdupq_n_s16(0));
        continue;
      }
      const uint16x4_t first = background(x);
      const uint16x4_t second = background(x + 4);
      const uint16x8_t threshold = vcombine_u16(below(first), below(second));
      const uint16x8_t level = vcombine_u16(first, second);
      const uint16x8_t grey = vld1q_u16(row.grey + x);
      const uint16x8_t v = kIsLight ? vqsubq_u16(grey, level) : vqsubq_u16(level, grey);  // saturates at zero
      vst1q_s16(row.weight + x, vreinterpretq_s16_u16(vqsubq_u16(v, threshold)));
    }
  }
};

}  // namespace ruffini
