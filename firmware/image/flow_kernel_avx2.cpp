#include <immintrin.h>

#include "image/flow_kernel.h"

namespace ruffini::flow_kernel {
namespace {

// Loads two rows of eight, `apart` values from one another.
__m256i two_rows(const int16_t* p, ptrdiff_t apart) {
  const __m128i low = _mm_loadu_si128(reinterpret_cast<const __m128i*>(p));
  return _mm256_inserti128_si256(_mm256_castsi128_si256(low),
                                 _mm_loadu_si128(reinterpret_cast<const __m128i*>(p + apart)), 1);
}

__m256i between(__m256i a, __m256i b, __m256i f) {
  return _mm256_add_epi16(a, _mm256_mulhrs_epi16(_mm256_sub_epi16(b, a), f));
}

__m256i load(const int16_t* p) { return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p)); }

int32_t sum(__m256i lanes) {
  __m128i half = _mm_add_epi32(_mm256_castsi256_si128(lanes), _mm256_extracti128_si256(lanes, 1));
  half = _mm_add_epi32(half, _mm_shuffle_epi32(half, 0x4E));
  half = _mm_add_epi32(half, _mm_shuffle_epi32(half, 0xB1));
  return _mm_cvtsi128_si32(half);
}

// Samples rows 2 i and 2 i + 1, i = 0..3.
template <typename Use>
void each_pair(const Block& block, Use use) {
  const __m256i fx = _mm256_set1_epi16(block.x_q15);
  const __m256i fy = _mm256_set1_epi16(block.y_q15);
  const int16_t* p = block.at;
  for (int i = 0; i < kSide / 2; ++i, p += 2 * block.row_step) {
    const int16_t* q = p + block.stride;
    const __m256i upper = between(two_rows(p, block.row_step), two_rows(p + 1, block.row_step), fx);
    const __m256i lower = between(two_rows(q, block.row_step), two_rows(q + 1, block.row_step), fx);
    use(ptrdiff_t{16} * i, between(upper, lower, fy));
  }
}

GradientSums gradient(const Block& block, const int16_t* h) {
  __m256i x = _mm256_setzero_si256();
  __m256i y = _mm256_setzero_si256();
  each_pair(block, [&](ptrdiff_t at, __m256i v) {
    x = _mm256_add_epi32(x, _mm256_madd_epi16(v, load(h + at)));
    y = _mm256_add_epi32(y, _mm256_madd_epi16(v, load(h + kArea + at)));
  });
  return {sum(x), sum(y)};
}

CorrelationSums correlation(const Block& block, const int16_t* t) {
  const __m256i one = _mm256_set1_epi16(1);
  __m256i value = _mm256_setzero_si256();
  __m256i square = _mm256_setzero_si256();
  __m256i product = _mm256_setzero_si256();
  each_pair(block, [&](ptrdiff_t at, __m256i v) {
    value = _mm256_add_epi32(value, _mm256_madd_epi16(v, one));
    square = _mm256_add_epi32(square, _mm256_madd_epi16(v, v));
    product = _mm256_add_epi32(product, _mm256_madd_epi16(v, load(t + at)));
  });
  return {sum(value), sum(square), sum(product)};
}

MisfitSums misfit(const int16_t* at, ptrdiff_t stride, const int16_t* value) {
  const __m256i one = _mm256_set1_epi16(1);
  __m256i square = _mm256_setzero_si256();  // eight lanes of eight squares of at most 4080: below 2^28
  __m256i sum_of = _mm256_setzero_si256();
  for (int i = 0; i < kSide / 2; ++i) {
    const __m256i e = _mm256_sub_epi16(two_rows(at + 2 * i * stride, stride), load(value + ptrdiff_t{16} * i));
    square = _mm256_add_epi32(square, _mm256_madd_epi16(e, e));
    sum_of = _mm256_add_epi32(sum_of, _mm256_madd_epi16(e, one));
  }
  return {sum(square), sum(sum_of)};  // 64 squares: below 2^30
}

}  // namespace

const Version kAvx2 = {gradient, correlation, misfit};

}  // namespace ruffini::flow_kernel
