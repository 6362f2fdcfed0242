#if defined(__aarch64__)
#include <arm_neon.h>
#else  // tests run this file on other processors, too
#define SIMDE_ENABLE_NATIVE_ALIASES
#include <simde/arm/neon.h>
#endif

#include <cstring>

#include "solve/block_kernel.h"

namespace ruffini::block_kernel {
namespace {

// Rows in pairs: one shift and one sum for both.
template <size_t kN>
struct Neon {
  static constexpr size_t kPairs = (kN + 1) / 2;
  struct Vector {
    int16x8_t part[4];
  };

  static Vector load(const int16_t* at) {
    return {{vld1q_s16(at), vld1q_s16(at + 8), vld1q_s16(at + 16), vld1q_s16(at + 24)}};
  }

  // Two halves of the sum of 32 products.
  static int64x2_t product(const int16_t* entry, const Vector& u) {
    __builtin_prefetch(reinterpret_cast<const char*>(entry) + kAheadBytes);
    const Vector a = load(entry);
    int32x4_t low = vmull_s16(vget_low_s16(a.part[0]), vget_low_s16(u.part[0]));
    int32x4_t high = vmull_high_s16(a.part[0], u.part[0]);  // with `low` eight int32 of four products
    for (size_t i = 1; i < 4; ++i) {
      low = vmlal_s16(low, vget_low_s16(a.part[i]), vget_low_s16(u.part[i]));
      high = vmlal_high_s16(high, a.part[i], u.part[i]);
    }
    return vpadalq_s32(vpaddlq_s32(low), high);
  }

  // The shifts of kN rows, two by two.
  static void load_shifts(const uint8_t* at, int64x2_t* shift) {
    uint64_t bytes = 0;
    std::memcpy(&bytes, at, kN);
    const uint16x8_t wide = vmovl_u8(vcreate_u8(bytes));
    const uint32x4_t quarter[2] = {vmovl_u16(vget_low_u16(wide)), vmovl_u16(vget_high_u16(wide))};
    for (size_t i = 0; i < kPairs; ++i) {
      const uint32x4_t four = quarter[i / 2];
      shift[i] = vreinterpretq_s64_u64(vmovl_u32(i % 2 == 0 ? vget_low_u32(four) : vget_high_u32(four)));
    }
  }

  static void run(Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out) {
    int64x2_t sum[kPairs];
    for (int64x2_t& s : sum) s = vdupq_n_s64(0);
    for (const uint16_t b : blocks) {
      const Vector v = load(u + size_t{b} * kBlock);
      const int16_t* q = table.q + size_t{b} * kN * kBlock;
      int64x2_t shift[kPairs];
      load_shifts(table.shift + size_t{b} * kN, shift);
      for (size_t i = 0; i < kPairs; ++i) {
        const int64x2_t first = product(q + 2 * i * kBlock, v);
        const int64x2_t second = 2 * i + 1 < kN ? product(q + (2 * i + 1) * kBlock, v) : vdupq_n_s64(0);
        sum[i] = vaddq_s64(sum[i], vshlq_s64(vpaddq_s64(first, second), shift[i]));
      }
    }
    for (size_t r = 0; r < kN; ++r) out[r] = r % 2 == 0 ? vgetq_lane_s64(sum[r / 2], 0) : vgetq_lane_s64(sum[r / 2], 1);
  }
};

}  // namespace

void rows_neon(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out) {
  dispatch<Neon>(n_rows, table, u, blocks, out);
}

}  // namespace ruffini::block_kernel
