#include "image/flow_kernel.h"

#include "base/processor.h"

namespace ruffini::flow_kernel {
namespace {

int between(int a, int b, int f_q15) { return a + (((b - a) * f_q15 + 16'384) >> 15); }

int sample(const Block& block, ptrdiff_t row, ptrdiff_t column) {
  const int16_t* p = block.at + row * block.row_step + column;
  const int16_t* q = p + block.stride;
  return between(between(p[0], p[1], block.x_q15), between(q[0], q[1], block.x_q15), block.y_q15);
}

template <typename Use>
void each_sample(const Block& block, Use use) {
  size_t i = 0;
  for (ptrdiff_t row = 0; row < kSide; ++row) {
    for (ptrdiff_t column = 0; column < kSide; ++column, ++i) use(i, sample(block, row, column));
  }
}

GradientSums gradient(const Block& block, const int16_t* h) {
  GradientSums sums;
  each_sample(block, [&](size_t i, int v) {
    sums.x += h[i] * v;
    sums.y += h[kArea + i] * v;
  });
  return sums;
}

CorrelationSums correlation(const Block& block, const int16_t* t) {
  CorrelationSums sums;
  each_sample(block, [&](size_t i, int v) {
    sums.value += v;
    sums.square += v * v;
    sums.product += t[i] * v;
  });
  return sums;
}

MisfitSums misfit(const int16_t* at, ptrdiff_t stride, const int16_t* value) {
  MisfitSums sums;
  for (ptrdiff_t row = 0; row < kSide; ++row) {
    for (ptrdiff_t column = 0; column < kSide; ++column) {
      const int e = at[row * stride + column] - value[row * kSide + column];
      sums.square += e * e;
      sums.value += e;
    }
  }
  return sums;
}

}  // namespace

const Version kScalar = {gradient, correlation, misfit};

const Version& fastest_supported() {
#if defined(__x86_64__)
  return has_avx2() ? kAvx2 : kScalar;
#elif defined(__aarch64__)
  return kNeon;
#else
  return kScalar;
#endif
}

}  // namespace ruffini::flow_kernel
