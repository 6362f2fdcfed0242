// The transforms and the solve wave by wave, on lanes (lanes_scalar.h): the middle part of poisson.h. Bounds, besides
// those of the transforms: waves are clamped to +-2^29 (kMaxWave, counted), so that sums and differences stay within 31
// bits and the inverse transform within 30.
#pragma once

#include <algorithm>
#include <bit>
#include <cstdlib>

#include "image/lanes_scalar.h"
#include "image/poisson.h"

namespace ruffini {

template <typename L>
class PoissonWaves {
 public:
  PoissonWaves(const PoissonTables& tables, PoissonBuffers& buffers, SaturationCounter& saturations)
      : t_(tables),
        b_(buffers),
        saturations_(saturations),
        n_x_(static_cast<size_t>(tables.grid.n_x)),
        n_y_(static_cast<size_t>(tables.grid.n_y)) {}

  // Computes F in Q8 from f in Q11. n max|f| 2^up < 2^30.
  void transform_rows(int32_t largest_f) {
    const int up = std::min(30 - bit_width((int64_t{largest_f} + 1) * t_.grid.n_x), kMaxUp);  // -3 at the least
    const CosineTransform<L> transform(t_.cosine);
    V* in = work();
    V* out = in + t_.stride;
    std::fill(out, out + t_.stride, L::broadcast(0));
    for (size_t y = 0; y < n_y_; y += kLanes) {
      with_scale(up, [&](auto scaled) { load_columns(y, in, scaled); });
      transform.forward(in, out, out + t_.stride);
      with_scale(-3 - up, [&](auto scaled) { store_columns(y, out, scaled); });
    }
  }

  // k = 0: integrates the row sums twice.
  void sum_column() {
    int64_t flux = 0;
    int64_t height = 0;
    for (size_t y = 0; y < n_y_; ++y) {
      b_.column[y] = clamp_wave(height);
      flux += b_.row_f(y)[0];
      height += flux;
      b_.row_f(y)[0] = 0;  // solve_columns() keeps it zero: the factors of k = 0 are zero
    }
  }

  // Solves the waves k > 0, tridiagonal along y. Returns the largest magnitude of all waves.
  int32_t solve_columns() {
    V n_clamped = L::broadcast(0);
    const size_t stride = t_.stride;  // a copy that no store can change stays in registers
    for (size_t y = 0; y < n_y_; ++y) {
      const int32_t* const factor = t_.factor_q31.data() + y * stride;
      int32_t* const row = b_.row_f(y);
      const auto each = [&](auto above, auto divided) {
        for (size_t k = 0; k < stride; k += kLanes) {
          const V sum = clamp_counted<L>(L::sub(above(k), L::load(row + k)), kMaxWave, n_clamped);
          L::store(row + k, divided(sum, k));
        }
      };
      const auto none = [](size_t) { return L::broadcast(0); };
      const auto row_above = [&](size_t k) { return L::load(row - stride + k); };
      const auto by_pivot = [&](V sum, size_t k) { return L::mul_q31(sum, L::load(factor + k)); };
      const auto undivided = [](V sum, size_t) { return sum; };
      const bool is_last = y + 1 == n_y_;
      if (y == 0) {
        is_last ? each(none, undivided) : each(none, by_pivot);
      } else {
        is_last ? each(row_above, undivided) : each(row_above, by_pivot);
      }
    }
    int32_t* last = b_.row_f(n_y_ - 1);
    for (size_t k = 1; k < n_x_; ++k) last[k] = clamp_wave(divide_q30(last[k], t_.last_pivot_q30[k]));
    V largest = L::broadcast(0);
    for (size_t k = 0; k < stride; k += kLanes) largest = L::max(largest, L::abs(L::load(last + k)));
    for (size_t y = n_y_ - 1; y-- > 0;) {
      const int32_t* const factor = t_.factor_q31.data() + y * stride;
      int32_t* const row = b_.row_f(y);
      for (size_t k = 0; k < stride; k += kLanes) {
        const V below = L::mul_q31(L::load(row + stride + k), L::load(factor + k));
        const V z = clamp_counted<L>(L::add(L::load(row + k), below), kMaxWave, n_clamped);
        largest = L::max(largest, L::abs(z));
        L::store(row + k, z);
      }
    }
    saturations_.count += static_cast<uint64_t>(L::sum(n_clamped));
    int32_t most = L::max_lane(largest);
    for (size_t y = 0; y < n_y_; ++y) most = std::max(most, std::abs(b_.column[y]));
    return most;
  }

  // Computes w in Q8. The transform gets v = z 2 / n (1 / n for k = 0) with `up` more bits: n max|v| 2^up <= 2^30.
  void invert_rows(int32_t largest_wave) {
    const int up = std::min(29 - bit_width(largest_wave), kMaxUp);                             // -1 at the least
    const auto scale = static_cast<int32_t>((int64_t{2} << 30) / static_cast<int64_t>(n_x_));  // Q30
    const CosineTransform<L> transform(t_.cosine);
    V* in = work();
    V* out = in + t_.stride;
    std::fill(out, out + t_.stride, L::broadcast(0));
    const V factor = L::broadcast(scale);
    for (size_t y = 0; y < n_y_; y += kLanes) {
      // (v 2^(up + 1)) scale / 2^31; the first factor is below 2^30
      load_columns(y, in, [&](V v) { return L::mul_q31(L::shift_left(v, up + 1), factor); });
      in[0] = L::narrow(L::scale(L::load(b_.column.data() + y), scale), 31 - up);
      transform.inverse(in, out, out + t_.stride);
      with_scale(-up, [&](auto scaled) { store_columns(y, out, scaled); });
    }
  }

 private:
  using V = typename L::V;
  static constexpr size_t kLanes = L::kCount;
  static constexpr int kMaxWave = 1 << 29;  // Q8 of n_x / 2 heights
  static constexpr int kMaxUp = 16;         // a larger shift gains nothing: inputs are whole steps

  // Loads rows y, y + 1, ... of f, one per lane, transposed to vectors of one column each, each through `scaled`.
  template <typename Scaled>
  void load_columns(size_t y, V* out, Scaled scaled) {
    const size_t stride = t_.stride;
    const int32_t* const row = b_.row_f(y);
    for (size_t x = 0; x < stride; x += kLanes) {
      V block[kLanes];
      for (size_t j = 0; j < kLanes; ++j) block[j] = L::load(row + j * stride + x);
      L::transpose(block);
      for (size_t j = 0; j < kLanes; ++j) out[x + j] = scaled(block[j]);
    }
  }
  template <typename Scaled>
  void store_columns(size_t y, const V* in, Scaled scaled) {
    const size_t stride = t_.stride;
    int32_t* const row = b_.row_f(y);
    for (size_t x = 0; x < stride; x += kLanes) {
      V block[kLanes];
      for (size_t j = 0; j < kLanes; ++j) block[j] = scaled(in[x + j]);
      L::transpose(block);
      for (size_t j = 0; j < kLanes; ++j) L::store(row + j * stride + x, block[j]);
    }
  }
  // First suitably aligned address; `work` has room for the alignment.
  V* work() {
    auto* const bytes = reinterpret_cast<char*>(b_.work.data());
    return reinterpret_cast<V*>(bytes + (32 - reinterpret_cast<uintptr_t>(bytes) % 32) % 32);
  }

  static int bit_width(int64_t x) { return static_cast<int>(std::bit_width(static_cast<uint64_t>(x))); }

  // Calls `run` with a function that multiplies a vector by 2^up, rounding if `up` is negative.
  template <typename Run>
  static void with_scale(int up, Run run) {
    if (up >= 0) {
      run([up](V v) { return L::shift_left(v, up); });
    } else {
      run([up](V v) { return L::round_shift_right(v, -up); });
    }
  }

  int32_t clamp_wave(int64_t z) {
    const int64_t held = std::clamp<int64_t>(z, -kMaxWave, kMaxWave);
    saturations_.count += held == z ? 0 : 1;
    return static_cast<int32_t>(held);
  }
  // x / pivot with the pivot in Q30, half up. Precondition: |x| < 2^32.
  static int64_t divide_q30(int64_t x, int64_t pivot) { return floor_div(x * (int64_t{1} << 30) + pivot / 2, pivot); }

  const PoissonTables& t_;
  PoissonBuffers& b_;
  SaturationCounter& saturations_;
  size_t n_x_;
  size_t n_y_;
};

}  // namespace ruffini
