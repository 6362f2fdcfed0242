// AVX2 version of a row of difference.h, sixteen pixels at a time.
#pragma once

#include <immintrin.h>

#include "image/difference.h"

namespace ruffini {

// Gathers every third byte of 48, starting at byte `c`.
inline __m128i every_third(const __m128i* bytes, int c) {
  alignas(16) static constexpr int8_t kPick[3][3][16] = {
      {{0, 3, 6, 9, 12, 15, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1},
       {-1, -1, -1, -1, -1, -1, 2, 5, 8, 11, 14, -1, -1, -1, -1, -1},
       {-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, 1, 4, 7, 10, 13}},
      {{1, 4, 7, 10, 13, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1},
       {-1, -1, -1, -1, -1, 0, 3, 6, 9, 12, 15, -1, -1, -1, -1, -1},
       {-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, 2, 5, 8, 11, 14}},
      {{2, 5, 8, 11, 14, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1},
       {-1, -1, -1, -1, -1, 1, 4, 7, 10, 13, -1, -1, -1, -1, -1, -1},
       {-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, 0, 3, 6, 9, 12, 15}}};
  __m128i out = _mm_setzero_si128();
  for (int i = 0; i < 3; ++i) {
    const __m128i pick = _mm_load_si128(reinterpret_cast<const __m128i*>(kPick[c][i]));
    out = _mm_or_si128(out, _mm_shuffle_epi8(bytes[i], pick));
  }
  return out;
}

inline ExposureCounts difference_row_avx2(const DifferenceRow& row) {
  ExposureCounts counts;
  int x = 0;
  for (; x + 16 <= row.width; x += 16) {
    const auto* at = reinterpret_cast<const __m128i*>(row.pixels + ptrdiff_t{3} * x);
    const __m128i bytes[3] = {_mm_loadu_si128(at), _mm_loadu_si128(at + 1), _mm_loadu_si128(at + 2)};
    __m128i most = _mm_setzero_si128();
    __m256i sum = _mm256_setzero_si256();
    for (int c = 0; c < 3; ++c) {
      const __m128i level = every_third(bytes, c);
      most = _mm_max_epu8(most, level);
      const __m256i wide = _mm256_cvtepu8_epi16(level);
      sum = _mm256_add_epi16(sum, c == 1 ? _mm256_slli_epi16(wide, 1) : wide);
      const ptrdiff_t i = c * row.plane + x;
      const __m256i rest8 = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(row.rest8 + i));
      const __m256i reciprocal = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(row.reciprocal + i));
      const __m256i moved8 = _mm256_sub_epi16(_mm256_slli_epi16(wide, 7), rest8);
      _mm256_storeu_si256(reinterpret_cast<__m256i*>(row.change + i), _mm256_mulhrs_epi16(moved8, reciprocal));
    }
    const __m256i grey = _mm256_add_epi16(_mm256_slli_epi16(sum, 3), _mm256_slli_epi16(sum, 2));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(row.grey + x), grey);
    const __m128i dark = _mm_cmpeq_epi8(_mm_subs_epu8(most, _mm_set1_epi8(kDarkLevel - 1)), _mm_setzero_si128());
    const __m128i full = _mm_cmpeq_epi8(most, _mm_set1_epi8(-1));
    counts.dark += __builtin_popcount(static_cast<unsigned>(_mm_movemask_epi8(dark)));
    counts.full += __builtin_popcount(static_cast<unsigned>(_mm_movemask_epi8(full)));
  }
  const ExposureCounts rest = difference_row_scalar(row, x);
  return {counts.dark + rest.dark, counts.full + rest.full};
}

}  // namespace ruffini
