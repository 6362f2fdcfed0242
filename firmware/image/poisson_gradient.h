// Slope to divergence of the gradient, on lanes (lanes_scalar.h): the first part of poisson.h. Bounds:
//
//   gradient   |s| <= 2^15, 1 / (1 - e) < 10.3 in Q24 (its table's line below 0.1), cell < 2^23 in Q10: scale in Q14
//              below 2^31, s scale < 2^46; shifted for mul_q31, 8 times the inverse, 2^8 cell and 2^15 s fit 32 bits
//   f          four gradients of 2^20, doubled: |f| <= 2^23
#pragma once

#include <algorithm>

#include "image/lanes_scalar.h"
#include "image/poisson.h"

namespace ruffini {

template <typename L>
class PoissonGradient {
 public:
  PoissonGradient(const PoissonTables& tables, PoissonBuffers& buffers, SaturationCounter& saturations)
      : t_(tables),
        b_(buffers),
        saturations_(saturations),
        n_x_(static_cast<size_t>(tables.grid.n_x)),
        n_y_(static_cast<size_t>(tables.grid.n_y)) {}

  // Computes both gradients of all cells.
  void learn(std::span<const CellSlope> slope) {
    const size_t whole = n_x_ / L::kCount * L::kCount;
    for (size_t y = 0; y < n_y_; ++y) {
      const CellSlope* line = slope.data() + y * n_x_;
      gradient_row<L>(line, y, 0, whole);
      gradient_row<ScalarLanes>(line, y, whole, n_x_);
      // Mirroring with inverted sign makes the gradient at the border zero.
      b_.row_x(y)[-1] = -b_.row_x(y)[0];
      b_.row_x(y)[n_x_] = -b_.row_x(y)[n_x_ - 1];
    }
    for (size_t x = 0; x < n_x_; ++x) {
      b_.row_y(0)[static_cast<ptrdiff_t>(x) - static_cast<ptrdiff_t>(t_.stride)] = -b_.row_y(0)[x];
      b_.row_y(n_y_)[x] = -b_.row_y(n_y_ - 1)[x];
    }
  }

  // Computes f and returns the largest |f|. Gradients in the padding are zero, except for the mirror image.
  int32_t divergence() {
    const size_t stride = t_.stride;  // a copy that no store can change stays in registers
    const size_t whole = n_x_ / L::kCount * L::kCount;
    V largest = L::broadcast(0);
    for (size_t y = 0; y < n_y_; ++y) {
      const int32_t* gx = b_.row_x(y);
      const int32_t* above = b_.row_y(y) - stride;
      const int32_t* below = b_.row_y(y) + stride;
      int32_t* f = b_.row_f(y);
      const auto divergence_at = [&](size_t x) {
        const V along_x = L::sub(L::load(gx + x + 1), L::load(gx + x - 1));
        const V along_y = L::sub(L::load(below + x), L::load(above + x));
        const V both = L::add(along_x, along_y);
        L::store(f + x, both);
        return both;
      };
      for (size_t x = 0; x < whole; x += L::kCount) largest = L::max(largest, L::abs(divergence_at(x)));
      if (whole == stride) continue;
      for (size_t x = whole; x < stride; x += L::kCount) divergence_at(x);
      std::fill(f + n_x_, f + stride, 0);
      for (size_t x = whole; x < stride; x += L::kCount) largest = L::max(largest, L::abs(L::load(f + x)));
    }
    return L::max_lane(largest);
  }

 private:
  using V = typename L::V;
  static constexpr int kOneQ14 = 16'384;
  static constexpr int kMaxFold = kOneQ14 * 9 / 10;  // beyond this the surface would hide itself from the ray
  static constexpr int kMinFold = -kOneQ14;
  static constexpr int kMaxGradient = 1 << 20;  // Q10: 1 mm per cell

  // Cells [from, to) of row y, as many at once as `Some` has lanes.
  template <typename Some>
  void gradient_row(const CellSlope* slope, size_t y, size_t from, size_t to) {
    auto n_clamped = Some::broadcast(0);
    const int32_t* const ray_x_q16 = t_.ray_x_q16.data();
    const int32_t ray_y_q16 = t_.ray_y_q16[y];
    const int32_t* const inverse_q24 = t_.inverse_q24.data();
    const int32_t cell_um_q10 = t_.cell_um_q10;
    const auto cell_um_q18 = Some::broadcast(cell_um_q10 << 8);
    int32_t* const out_x = b_.row_x(y);
    int32_t* const out_y = b_.row_y(y);
    for (size_t x = from; x < to; x += Some::kCount) {
      const auto both = Some::load(slope + x);  // x in the low half, y in the high one
      const auto sx_high = Some::template shift_left<16>(both);
      const auto sx = Some::template shift_right<16>(sx_high);
      const auto sy = Some::template shift_right<16>(both);
      const auto along = Some::add_scaled(Some::mul(sx, Some::load(ray_x_q16 + x)), sy, ray_y_q16);
      const auto e =
          Some::max(Some::min(Some::template narrow<14>(along), Some::broadcast(kMaxFold)), Some::broadcast(kMinFold));
      const auto rest = Some::sub(Some::broadcast(kOneQ14), e);
      const auto line = Some::template shift_right<PoissonTables::kFoldStep>(rest);
      const auto fraction = Some::bit_and(rest, Some::broadcast((1 << PoissonTables::kFoldStep) - 1));
      typename Some::V low;
      typename Some::V high;
      Some::gather_pair(inverse_q24, line, low, high);
      const auto inverse = Some::add(
          low, Some::round_shift_right(Some::mul_low(Some::sub(high, low), fraction), PoissonTables::kFoldStep));
      const auto scale = Some::mul_q31(Some::template shift_left<3>(inverse), cell_um_q18);  // Q14
      const auto g_x = Some::mul_q31(Some::template shift_right<1>(sx_high), scale);
      const auto g_y = Some::mul_q31(Some::template shift_left<15>(sy), scale);
      Some::store(out_x + x, clamp_counted<Some>(g_x, kMaxGradient, n_clamped));
      Some::store(out_y + x, clamp_counted<Some>(g_y, kMaxGradient, n_clamped));
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
