// One lane of 32-bit integers: the reference for lanes_avx2.h and lanes_neon.h, which process several.
//
// A kernel is written once, as a template over the lanes (image/kernels.h). All operations are exact, or round half up
// as round_shift does, so every version is bit-identical. Callers prove that no sum exceeds 32 bits and no Wide 64.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>

#include "base/fixed.h"

namespace ruffini {

struct ScalarLanes {
  using V = int32_t;
  using Wide = int64_t;  // products, and sums of them
  static constexpr int kCount = 1;

  static V load(const void* at) {
    V v;
    std::memcpy(&v, at, sizeof v);
    return v;
  }
  static void store(void* at, V v) { std::memcpy(at, &v, sizeof v); }
  static V load_16(const int16_t* at) { return *at; }
  static void store_16(int16_t* at, V v) { *at = static_cast<int16_t>(v); }  // precondition: v fits 16 bits
  static V broadcast(int32_t x) { return x; }

  static V add(V a, V b) { return a + b; }
  // Modulo 2^32.
  static V sub(V a, V b) { return static_cast<V>(static_cast<uint32_t>(a) - static_cast<uint32_t>(b)); }
  static V min(V a, V b) { return std::min(a, b); }
  static V max(V a, V b) { return std::max(a, b); }
  static V abs(V a) { return a < 0 ? -a : a; }
  static V bit_and(V a, V b) { return a & b; }
  // 1 in every lane where a and b differ.
  static V not_equal(V a, V b) { return a == b ? 0 : 1; }
  template <int kShift>
  static V shift_left(V a) {
    return static_cast<V>(static_cast<uint32_t>(a) << kShift);
  }
  static V shift_left(V a, int shift) { return static_cast<V>(static_cast<uint32_t>(a) << shift); }
  template <int kShift>
  static V shift_right(V a) {
    return a >> kShift;  // towards minus infinity
  }
  // Half up. Precondition: 1 <= shift <= 30 and a + 2^(shift - 1) fits.
  static V round_shift_right(V a, int shift) { return (a + (1 << (shift - 1))) >> shift; }
  // Low 32 bits of the product.
  static V mul_low(V a, V b) { return static_cast<V>(static_cast<uint32_t>(a) * static_cast<uint32_t>(b)); }

  // Sum of values & keep over each lane's kStep numbers side by side.
  template <int kStep>
  static V masked_sum(const int16_t* values, const int16_t* keep) {
    V out = 0;
    for (int i = 0; i < kStep; ++i) out += values[i] & keep[i];
    return out;
  }

  static Wide mul(V a, V b) { return int64_t{a} * b; }
  // Every lane times the same number.
  static Wide scale(V a, int32_t c) { return int64_t{a} * c; }
  static Wide add_wide(Wide a, Wide b) { return a + b; }
  static Wide sub_wide(Wide a, Wide b) { return a - b; }
  static Wide add_scaled(Wide sum, V a, int32_t c) { return sum + int64_t{a} * c; }
  static Wide sub_scaled(Wide sum, V a, int32_t c) { return sum - int64_t{a} * c; }
  // Half up. Precondition: 1 <= shift <= 32 and the result fits 32 bits.
  static V narrow(Wide sum, int shift) { return static_cast<V>(round_shift(sum, shift)); }

  // The same with a shift that is known when compiled, which some processors have an instruction for.
  template <int kShift>
  static V narrow(Wide sum) {
    return narrow(sum, kShift);
  }

  // a b / 2^31, half up. Precondition: not both are -2^31.
  static V mul_q31(V a, V b) { return narrow<31>(mul(a, b)); }

  static V gather(const int32_t* table, V index) { return table[index]; }
  // Looks up two entries side by side.
  static void gather_pair(const int32_t* table, V index, V& first, V& second) {
    first = table[index];
    second = table[index + 1];
  }
  static void transpose(V* /*block: kCount vectors*/) {}
  static int64_t sum(V a) { return a; }
  static int32_t max_lane(V a) { return a; }
};

// Clamps v to +-limit and adds the number of clamped lanes to n_clamped.
template <typename L>
typename L::V clamp_counted(typename L::V v, int32_t limit, typename L::V& n_clamped) {
  const typename L::V out = L::max(L::min(v, L::broadcast(limit)), L::broadcast(-limit));
  n_clamped = L::add(n_clamped, L::not_equal(out, v));
  return out;
}

}  // namespace ruffini
