// AVX2 versions of the lines of glow.h, sixteen pixels at a time.
#pragma once

#include <immintrin.h>

#include "image/difference_avx2.h"
#include "image/glow.h"

namespace ruffini {

inline void glow_row_avx2(const GlowRow& row) {
  int x = 0;
  for (; x + 16 <= row.width; x += 16) {
    const auto* at = reinterpret_cast<const __m128i*>(row.pixels + ptrdiff_t{3} * x);
    const __m128i bytes[3] = {_mm_loadu_si128(at), _mm_loadu_si128(at + 1), _mm_loadu_si128(at + 2)};
    __m256i sum = _mm256_setzero_si256();
    for (int c = 0; c < 3; ++c) {
      const int16_t weight = row.weight[static_cast<size_t>(c)];
      if (weight == 0) continue;
      const __m256i level = _mm256_cvtepu8_epi16(every_third(bytes, c));
      sum = _mm256_add_epi16(sum, _mm256_mullo_epi16(level, _mm256_set1_epi16(weight)));
    }
    const __m256i base = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(row.base + x));
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(row.glow + x), _mm256_sub_epi16(_mm256_slli_epi16(sum, 2), base));
  }
  glow_row_scalar(row, x);
}

inline void smooth_line_avx2(const SmoothLine& line) {
  const auto load = [](const int16_t* at) { return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(at)); };
  int x = 0;
  for (; x + 16 <= line.width; x += 16) {
    __m256i sum = _mm256_mulhrs_epi16(load(line.in[kSmoothReach] + x), _mm256_set1_epi16(kSmoothTap[0]));
    for (size_t k = 1; k <= kSmoothReach; ++k) {
      const __m256i pair = _mm256_add_epi16(load(line.in[kSmoothReach - k] + x), load(line.in[kSmoothReach + k] + x));
      sum = _mm256_add_epi16(sum, _mm256_mulhrs_epi16(pair, _mm256_set1_epi16(kSmoothTap[k])));
    }
    _mm256_storeu_si256(reinterpret_cast<__m256i*>(line.out + x), sum);
  }
  smooth_line_scalar(line, x);
}

}  // namespace ruffini
