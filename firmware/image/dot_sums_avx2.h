// AVX2 version of dot_sums.h, sixteen values at a time.
#pragma once

#include <immintrin.h>

#include "image/dot_sums.h"

namespace ruffini {

// Luma of the eight pixels that begin at `at`.
inline __m128i luma_avx2(const uint8_t* at) {
  const __m256i bytes = _mm256_set_m128i(_mm_loadu_si128(reinterpret_cast<const __m128i*>(at + 8)),
                                         _mm_loadu_si128(reinterpret_cast<const __m128i*>(at)));
  const __m256i pick_bg = _mm256_setr_epi8(0, -1, 1, -1, 3, -1, 4, -1, 6, -1, 7, -1, 9, -1, 10, -1,  //
                                           4, -1, 5, -1, 7, -1, 8, -1, 10, -1, 11, -1, 13, -1, 14, -1);
  const __m256i pick_r = _mm256_setr_epi8(2, -1, -1, -1, 5, -1, -1, -1, 8, -1, -1, -1, 11, -1, -1, -1,  //
                                          6, -1, -1, -1, 9, -1, -1, -1, 12, -1, -1, -1, 15, -1, -1, -1);
  const __m256i bg = _mm256_madd_epi16(_mm256_shuffle_epi8(bytes, pick_bg), _mm256_set1_epi32(601 << 16 | 117));
  const __m256i r = _mm256_madd_epi16(_mm256_shuffle_epi8(bytes, pick_r), _mm256_set1_epi32(306));
  const __m256i sum = _mm256_srli_epi32(_mm256_add_epi32(_mm256_add_epi32(bg, r), _mm256_set1_epi32(32)), 6);
  return _mm_packus_epi32(_mm256_castsi256_si128(sum), _mm256_extracti128_si256(sum, 1));
}

inline int64_t sum_of_lanes_avx2(__m256i v) {
  const __m256i wide = _mm256_add_epi64(_mm256_cvtepi32_epi64(_mm256_castsi256_si128(v)),
                                        _mm256_cvtepi32_epi64(_mm256_extracti128_si256(v, 1)));
  const __m128i two = _mm_add_epi64(_mm256_castsi256_si128(wide), _mm256_extracti128_si256(wide, 1));
  return _mm_cvtsi128_si64(two) + _mm_extract_epi64(two, 1);
}

inline DotSums dot_sums_avx2(const DotWindow& given) {
  const DotWindow window = given;  // a copy that no store can change stays in registers
  if (window.side < kLumaLanes) return dot_sums_scalar(window);
  make_luma(window,
            [](const uint8_t* at, int16_t* out) { _mm_storeu_si128(reinterpret_cast<__m128i*>(out), luma_avx2(at)); });
  const auto load = [](const int16_t* at) { return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(at)); };
  const auto between = [](__m256i a, __m256i b, __m256i share) {
    return _mm256_add_epi16(a, _mm256_mulhrs_epi16(_mm256_sub_epi16(b, a), share));
  };
  const __m256i share_x = _mm256_set1_epi16(window.share_x);
  const __m256i share_y = _mm256_set1_epi16(window.share_y);
  __m256i h_x = _mm256_setzero_si256();
  __m256i h_y = h_x, sum = h_x, square = h_x, common = h_x;
  for (int i = 0; i < window.n_values; i += DotWindow::kLanes) {
    const int16_t* at = window.luma + i;
    const __m256i above = between(load(at), load(at + 1), share_x);
    const __m256i below = between(load(at + window.side), load(at + window.side + 1), share_x);
    const __m256i value = _mm256_and_si256(between(above, below, share_y), load(window.keep + i));
    const auto add = [value](__m256i& total, __m256i factor) {
      total = _mm256_add_epi32(total, _mm256_madd_epi16(value, factor));
    };
    add(h_x, load(window.h_x + i));
    add(h_y, load(window.h_y + i));
    add(sum, _mm256_set1_epi16(1));
    add(square, value);
    add(common, load(window.t + i));
  }
  return {.h_x = sum_of_lanes_avx2(h_x),
          .h_y = sum_of_lanes_avx2(h_y),
          .sum = sum_of_lanes_avx2(sum),
          .square = sum_of_lanes_avx2(square),
          .common = sum_of_lanes_avx2(common)};
}

}  // namespace ruffini
