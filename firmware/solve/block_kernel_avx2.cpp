#include <immintrin.h>

#include "solve/block_kernel.h"

namespace ruffini::block_kernel {
namespace {

template <size_t kN>
struct Avx2 {
  static void run(Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out) {
    __m256i sum[kN] = {};  // four int64 each
    for (const uint16_t b : blocks) {
      const auto* v = reinterpret_cast<const __m256i*>(u + size_t{b} * kBlock);
      const __m256i u_first = _mm256_loadu_si256(v);
      const __m256i u_second = _mm256_loadu_si256(v + 1);
      const int16_t* q = table.q + size_t{b} * kN * kBlock;
      const uint8_t* shift = table.shift + size_t{b} * kN;
      for (size_t r = 0; r < kN; ++r) {
        const auto* entry = reinterpret_cast<const __m256i*>(q + r * kBlock);
        __builtin_prefetch(reinterpret_cast<const char*>(entry) + kAheadBytes);
        const __m256i first = _mm256_madd_epi16(_mm256_loadu_si256(entry), u_first);
        const __m256i second = _mm256_madd_epi16(_mm256_loadu_si256(entry + 1), u_second);
        const __m256i lanes = _mm256_add_epi32(first, second);  // eight int32 of four products
        const __m256i wide = _mm256_add_epi64(_mm256_cvtepi32_epi64(_mm256_castsi256_si128(lanes)),
                                              _mm256_cvtepi32_epi64(_mm256_extracti128_si256(lanes, 1)));
        sum[r] = _mm256_add_epi64(sum[r], _mm256_sll_epi64(wide, _mm_cvtsi32_si128(shift[r])));
      }
    }
    for (size_t r = 0; r < kN; ++r) {
      const __m128i half = _mm_add_epi64(_mm256_castsi256_si128(sum[r]), _mm256_extracti128_si256(sum[r], 1));
      out[r] = _mm_cvtsi128_si64(half) + _mm_extract_epi64(half, 1);
    }
  }
};

}  // namespace

void rows_avx2(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out) {
  dispatch<Avx2>(n_rows, table, u, blocks, out);
}

}  // namespace ruffini::block_kernel
