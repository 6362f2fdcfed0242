#include <immintrin.h>

#include "solve/block_kernel.h"

namespace ruffini::block_kernel {

int64_t row_avx2(const int16_t* q, const uint8_t* shift, const int16_t* u, std::span<const uint16_t> blocks) {
  __m256i sum = _mm256_setzero_si256();  // four int64
  for (const uint16_t b : blocks) {
    const auto* entry = reinterpret_cast<const __m256i*>(q + size_t{b} * kBlock);
    const auto* v = reinterpret_cast<const __m256i*>(u + size_t{b} * kBlock);
    const __m256i first = _mm256_madd_epi16(_mm256_loadu_si256(entry), _mm256_loadu_si256(v));
    const __m256i second = _mm256_madd_epi16(_mm256_loadu_si256(entry + 1), _mm256_loadu_si256(v + 1));
    const __m256i lanes = _mm256_add_epi32(first, second);  // eight int32 of four products
    const __m256i wide = _mm256_add_epi64(_mm256_cvtepi32_epi64(_mm256_castsi256_si128(lanes)),
                                          _mm256_cvtepi32_epi64(_mm256_extracti128_si256(lanes, 1)));
    sum = _mm256_add_epi64(sum, _mm256_sll_epi64(wide, _mm_cvtsi32_si128(shift[b])));
  }
  const __m128i half = _mm_add_epi64(_mm256_castsi256_si128(sum), _mm256_extracti128_si256(sum, 1));
  return _mm_cvtsi128_si64(half) + _mm_extract_epi64(half, 1);
}

}  // namespace ruffini::block_kernel
