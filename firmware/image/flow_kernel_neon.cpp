#if defined(__aarch64__)
#include <arm_neon.h>
#else  // tests compile this file on other processors, too
#define SIMDE_ENABLE_NATIVE_ALIASES
#include <simde/arm/neon.h>
#endif

#include "image/flow_kernel.h"

namespace ruffini::flow_kernel {
namespace {

int16x8_t between(int16x8_t a, int16x8_t b, int16x8_t f) { return vaddq_s16(a, vqrdmulhq_s16(vsubq_s16(b, a), f)); }

int32x4_t add_products(int32x4_t sum, int16x8_t a, int16x8_t b) {
  return vmlal_high_s16(vmlal_s16(sum, vget_low_s16(a), vget_low_s16(b)), a, b);
}

template <typename Use>
void each_row(const Block& block, Use use) {
  const int16x8_t fx = vdupq_n_s16(block.x_q15);
  const int16x8_t fy = vdupq_n_s16(block.y_q15);
  const int16_t* p = block.at;
  for (ptrdiff_t row = 0; row < kSide; ++row, p += block.row_step) {
    const int16_t* q = p + block.stride;
    const int16x8_t upper = between(vld1q_s16(p), vld1q_s16(p + 1), fx);
    const int16x8_t lower = between(vld1q_s16(q), vld1q_s16(q + 1), fx);
    use(row * kSide, between(upper, lower, fy));
  }
}

GradientSums gradient(const Block& block, const int16_t* h) {
  int32x4_t x = vdupq_n_s32(0);
  int32x4_t y = vdupq_n_s32(0);
  each_row(block, [&](ptrdiff_t at, int16x8_t v) {
    x = add_products(x, v, vld1q_s16(h + at));
    y = add_products(y, v, vld1q_s16(h + kArea + at));
  });
  return {vaddvq_s32(x), vaddvq_s32(y)};
}

CorrelationSums correlation(const Block& block, const int16_t* t) {
  int32x4_t value = vdupq_n_s32(0);
  int32x4_t square = vdupq_n_s32(0);
  int32x4_t product = vdupq_n_s32(0);
  each_row(block, [&](ptrdiff_t at, int16x8_t v) {
    value = vpadalq_s16(value, v);
    square = add_products(square, v, v);
    product = add_products(product, v, vld1q_s16(t + at));
  });
  return {vaddvq_s32(value), vaddvq_s32(square), vaddvq_s32(product)};
}

MisfitSums misfit(const int16_t* at, ptrdiff_t stride, const int16_t* value) {
  int32x4_t square = vdupq_n_s32(0);
  int32x4_t sum = vdupq_n_s32(0);
  for (ptrdiff_t row = 0; row < kSide; ++row) {
    const int16x8_t e = vsubq_s16(vld1q_s16(at + row * stride), vld1q_s16(value + row * kSide));
    square = add_products(square, e, e);
    sum = vpadalq_s16(sum, e);
  }
  return {vaddvq_s32(square), vaddvq_s32(sum)};
}

}  // namespace

const Version kNeon = {gradient, correlation, misfit};

}  // namespace ruffini::flow_kernel
