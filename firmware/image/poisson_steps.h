// Complete solve of poisson.h on lanes (lanes_scalar.h). Bounds of the last step: |w| <= 2^21 (8 mm) and H >= 1 mm, so
// w / (2 H) and w / (3 H) in Q24 are below 2^26.1 and their polynomial is below 2^29. Shifted for mul_q31, 2^6 w,
// 2^36 / (2 H) and 2^36 / (3 H) in Q5, 2^4 w / (2 H) and 2^3 (1 + w / (3 H)) fit 32 bits.
#pragma once

#include <algorithm>

#include "image/poisson_gradient.h"
#include "image/poisson_waves.h"

namespace ruffini {

template <typename L>
class PoissonSteps {
 public:
  static void run(const PoissonTables& tables, PoissonBuffers& buffers, std::span<const CellSlope> slope,
                  std::span<DisplacementUm> depth, SaturationCounter& saturations) {
    PoissonGradient<L> gradient(tables, buffers, saturations);
    gradient.learn(slope);
    const int32_t largest_f = gradient.divergence();
    PoissonWaves<L> waves(tables, buffers, saturations);
    waves.transform_rows(largest_f);
    waves.sum_column();
    waves.invert_rows(waves.solve_columns());
    PoissonSteps(tables, buffers, saturations).finish(depth);
  }

 private:
  static constexpr int kMaxDepth = 1 << 21;  // Q8: 8 mm
  static constexpr int kFarOff = 1 << 29;    // Q8: 2 m, larger than any saturated value

  PoissonSteps(const PoissonTables& tables, PoissonBuffers& buffers, SaturationCounter& saturations)
      : t_(tables),
        b_(buffers),
        saturations_(saturations),
        n_x_(static_cast<size_t>(tables.grid.n_x)),
        n_y_(static_cast<size_t>(tables.grid.n_y)) {}

  void finish(std::span<DisplacementUm> depth) {
    int64_t sum = 0;
    for (const uint32_t cell : t_.gauge_cells) sum += b_.f[cell];
    const int64_t mean = floor_div(sum, static_cast<int64_t>(t_.gauge_cells.size()));
    const auto clamped_mean = static_cast<int32_t>(std::clamp<int64_t>(mean, -kFarOff, kFarOff));
    const size_t whole = n_x_ / L::kCount * L::kCount;
    for (size_t y = 0; y < n_y_; ++y) {
      auto* out = reinterpret_cast<int16_t*>(depth.data() + y * n_x_);
      finish_row<L>(b_.row_f(y), clamped_mean, out, 0, whole);
      finish_row<ScalarLanes>(b_.row_f(y), clamped_mean, out, whole, n_x_);
    }
  }

  // z = w (1 + w / (2 H) (1 + w / (3 H)))
  template <typename Some>
  void finish_row(const int32_t* f, int32_t mean, int16_t* out, size_t from, size_t to) {
    const auto one_q24 = Some::broadcast(1 << 24);
    const auto inverse_2h = Some::broadcast(t_.inverse_2h << 5);
    const auto inverse_3h = Some::broadcast(t_.inverse_3h << 5);
    auto n_clamped = Some::broadcast(0);
    for (size_t x = from; x < to; x += Some::kCount) {
      const auto far = Some::max(Some::min(Some::load(f + x), Some::broadcast(kFarOff)), Some::broadcast(-kFarOff));
      const auto w = clamp_counted<Some>(Some::sub(far, Some::broadcast(mean)), kMaxDepth, n_clamped);
      const auto w_q14 = Some::template shift_left<6>(w);
      const auto third = Some::add(Some::mul_q31(w_q14, inverse_3h), one_q24);
      const auto second = Some::mul_q31(Some::template shift_left<4>(Some::mul_q31(w_q14, inverse_2h)),
                                        Some::template shift_left<3>(third));
      const auto z = Some::mul_q31(Some::template shift_left<2>(w), Some::add(second, one_q24));  // Q3
      const auto held = Some::max(Some::min(z, Some::broadcast(INT16_MAX)), Some::broadcast(INT16_MIN));
      n_clamped = Some::add(n_clamped, Some::not_equal(held, z));
      Some::store_16(out + x, held);
    }
    saturations_.count += static_cast<uint64_t>(Some::sum(n_clamped));
  }

  const PoissonTables& t_;
  PoissonBuffers& b_;
  SaturationCounter& saturations_;
  size_t n_x_;
  size_t n_y_;
};

}  // namespace ruffini
