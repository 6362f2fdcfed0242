// Eight lanes of 32-bit integers on AVX2; lanes_scalar.h documents each operation.
#pragma once

#include <immintrin.h>

#include <cstdint>

#include "image/lanes_scalar.h"

namespace ruffini {

struct Avx2Lanes {
  using V = __m256i;
  struct Wide {  // products of lanes 0, 2, 4, 6 and of lanes 1, 3, 5, 7
    __m256i even;
    __m256i odd;
  };
  static constexpr int kCount = 8;

  static V load(const void* at) { return _mm256_loadu_si256(static_cast<const __m256i*>(at)); }
  static void store(void* at, V v) { _mm256_storeu_si256(static_cast<__m256i*>(at), v); }
  static V load_16(const int16_t* at) {
    return _mm256_cvtepi16_epi32(_mm_loadu_si128(reinterpret_cast<const __m128i*>(at)));
  }
  static void store_16(int16_t* at, V v) {
    const __m128i packed = _mm_packs_epi32(_mm256_castsi256_si128(v), _mm256_extracti128_si256(v, 1));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(at), packed);
  }
  static V broadcast(int32_t x) { return _mm256_set1_epi32(x); }

  static V add(V a, V b) { return _mm256_add_epi32(a, b); }
  static V sub(V a, V b) { return _mm256_sub_epi32(a, b); }
  static V min(V a, V b) { return _mm256_min_epi32(a, b); }
  static V max(V a, V b) { return _mm256_max_epi32(a, b); }
  static V abs(V a) { return _mm256_abs_epi32(a); }
  static V bit_and(V a, V b) { return _mm256_and_si256(a, b); }
  static V not_equal(V a, V b) { return _mm256_add_epi32(_mm256_cmpeq_epi32(a, b), broadcast(1)); }
  template <int kShift>
  static V shift_left(V a) {
    return _mm256_slli_epi32(a, kShift);
  }
  static V shift_left(V a, int shift) { return _mm256_sll_epi32(a, _mm_cvtsi32_si128(shift)); }
  template <int kShift>
  static V shift_right(V a) {
    return _mm256_srai_epi32(a, kShift);
  }
  static V round_shift_right(V a, int shift) {
    return _mm256_sra_epi32(add(a, broadcast(1 << (shift - 1))), _mm_cvtsi32_si128(shift));
  }
  static V mul_low(V a, V b) { return _mm256_mullo_epi32(a, b); }

  template <int kStep>
  static V masked_sum(const int16_t* values, const int16_t* keep) {
    const auto kept = [&](int i) { return _mm256_and_si256(load(values + i), load(keep + i)); };
    if constexpr (kStep == 1) {
      return _mm256_and_si256(load_16(values), load_16(keep));
    } else if constexpr (kStep == 2) {
      return _mm256_madd_epi16(kept(0), _mm256_set1_epi16(1));
    } else if constexpr (kStep == 4) {
      const __m256i first = _mm256_madd_epi16(kept(0), _mm256_set1_epi16(1));
      const __m256i second = _mm256_madd_epi16(kept(16), _mm256_set1_epi16(1));
      return _mm256_permute4x64_epi64(_mm256_hadd_epi32(first, second), 0xD8);
    } else {
      alignas(32) int32_t sums[kCount];
      for (int i = 0; i < kCount; ++i) {
        sums[i] = ScalarLanes::masked_sum<kStep>(values + i * kStep, keep + i * kStep);
      }
      return load(sums);
    }
  }

  static Wide mul(V a, V b) {
    return {_mm256_mul_epi32(a, b), _mm256_mul_epi32(_mm256_srli_epi64(a, 32), _mm256_srli_epi64(b, 32))};
  }
  static Wide scale(V a, int32_t c) {
    return {_mm256_mul_epi32(a, broadcast(c)), _mm256_mul_epi32(_mm256_srli_epi64(a, 32), broadcast(c))};
  }
  static Wide add_wide(Wide a, Wide b) { return {_mm256_add_epi64(a.even, b.even), _mm256_add_epi64(a.odd, b.odd)}; }
  static Wide sub_wide(Wide a, Wide b) { return {_mm256_sub_epi64(a.even, b.even), _mm256_sub_epi64(a.odd, b.odd)}; }
  static Wide add_scaled(Wide sum, V a, int32_t c) {
    const Wide product = scale(a, c);
    return {_mm256_add_epi64(sum.even, product.even), _mm256_add_epi64(sum.odd, product.odd)};
  }
  static Wide sub_scaled(Wide sum, V a, int32_t c) { return sub_wide(sum, scale(a, c)); }
  static V narrow(Wide sum, int shift) {
    const __m256i half = _mm256_set1_epi64x(int64_t{1} << (shift - 1));
    const __m256i even = _mm256_srl_epi64(_mm256_add_epi64(sum.even, half), _mm_cvtsi32_si128(shift));
    const __m256i odd = _mm256_sll_epi64(_mm256_add_epi64(sum.odd, half), _mm_cvtsi32_si128(32 - shift));
    return _mm256_blend_epi32(even, odd, 0xAA);
  }

  template <int kShift>
  static V narrow(Wide sum) {
    return narrow(sum, kShift);
  }

  static V mul_q31(V a, V b) { return narrow<31>(mul(a, b)); }

  static V gather(const int32_t* table, V index) { return _mm256_i32gather_epi32(table, index, 4); }
  static void gather_pair(const int32_t* table, V index, V& first, V& second) {
    first = gather(table, index);
    second = gather(table + 1, index);
  }

  // Lane i becomes the sum of the lanes up to i, modulo 2^32. AVX2 only: the scalar reference adds up in
  // DotWeights::add_up.
  static V prefix_sums(V a) {
    a = _mm256_add_epi32(a, _mm256_slli_si256(a, 4));
    a = _mm256_add_epi32(a, _mm256_slli_si256(a, 8));  // of each half
    const V low_half = _mm256_permute2x128_si256(a, a, 0x08);
    return _mm256_add_epi32(a, _mm256_shuffle_epi32(low_half, 0xFF));
  }
  static V broadcast_last(V a) { return _mm256_permutevar8x32_epi32(a, broadcast(7)); }
  static int32_t first(V a) { return _mm256_cvtsi256_si32(a); }

  // Transposes eight vectors.
  static void transpose(V* block) {
    V pair[8];
    for (int i = 0; i < 8; i += 2) {
      pair[i] = _mm256_unpacklo_epi32(block[i], block[i + 1]);
      pair[i + 1] = _mm256_unpackhi_epi32(block[i], block[i + 1]);
    }
    V four[8];
    for (int i = 0; i < 8; i += 4) {
      four[i] = _mm256_unpacklo_epi64(pair[i], pair[i + 2]);
      four[i + 1] = _mm256_unpackhi_epi64(pair[i], pair[i + 2]);
      four[i + 2] = _mm256_unpacklo_epi64(pair[i + 1], pair[i + 3]);
      four[i + 3] = _mm256_unpackhi_epi64(pair[i + 1], pair[i + 3]);
    }
    for (int i = 0; i < 4; ++i) {
      block[i] = _mm256_permute2x128_si256(four[i], four[i + 4], 0x20);
      block[i + 4] = _mm256_permute2x128_si256(four[i], four[i + 4], 0x31);
    }
  }
  static int64_t sum(V a) {
    const __m128i four = _mm_add_epi32(_mm256_castsi256_si128(a), _mm256_extracti128_si256(a, 1));
    const __m128i two = _mm_add_epi32(four, _mm_shuffle_epi32(four, 0x4E));
    return _mm_cvtsi128_si32(_mm_add_epi32(two, _mm_shuffle_epi32(two, 0xB1)));
  }
  static int32_t max_lane(V a) {
    const __m128i four = _mm_max_epi32(_mm256_castsi256_si128(a), _mm256_extracti128_si256(a, 1));
    const __m128i two = _mm_max_epi32(four, _mm_shuffle_epi32(four, 0x4E));
    return _mm_cvtsi128_si32(_mm_max_epi32(two, _mm_shuffle_epi32(two, 0xB1)));
  }
};

}  // namespace ruffini
