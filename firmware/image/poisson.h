// Surface slope -> depth: exact discrete Poisson solve with free (Neumann) borders, in perspective.
//
// The gradient of w = H ln(1 + z/H), micrometres per cell, Q10, clamped to +-2^20 (firmware/README.md):
//
//   e = (s_x x' + s_y y' + 2^13) >> 14, at most 0.9       Q14; x', y' the ray's slopes, Q16
//   g = s (H step / f) / (1 - e)
//
// averaged to the half-way points between cells (kept doubled, so Q11), its divergence f; then
//
//   1. F = cosine transform of f along x
//   2. per wave number k, tridiagonal solve along y with the exact eigenvalue 2 - 2 cos(pi k / n_x), k from 0;
//      k = 0 is a plain double sum
//   3. w = inverse transform
//   4. gauge: minus the mean over the gauge cells; z = w + w^2 / (2 H) + w^3 / (6 H^2)
//
// A field that is a gradient on the half-way points is reproduced up to rounding (below 10 nm).
// Accumulators, up to kMaxCells = 640: |f| <= 2^23 and 640 products of Q30; |v| <= 2^26 (8 mm) and 640 products
// of Q27: both below 2^63. Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "image/photometric.h"

namespace ruffini {

// Cosine transform of a fixed length by splitting off the odd half while the length is even.
class CosineTransform {
 public:
  explicit CosineTransform(int n);

  // X_k = sum_i x_i cos(pi k (2 i + 1) / (2 n)). `work` holds 2 n values. In and out may not overlap.
  void forward(const int64_t* in, int64_t* out, int64_t* work) const;
  // x_i = sum_k a_k cos(pi k (2 i + 1) / (2 n)), coefficients in Q27.
  void inverse(const int64_t* in, int64_t* out, int64_t* work) const;

 private:
  struct Level {
    int n;                     // length at this level
    std::vector<int32_t> odd;  // n/2 x n/2, Q30: cos(pi (2 k + 1)(2 i + 1) / (2 n)), row k
  };
  void forward_level(size_t level, const int64_t* in, int64_t* out, int stride, int64_t* work) const;
  void inverse_level(size_t level, const int64_t* in, int stride, int64_t* out, int64_t* work) const;

  std::vector<Level> levels_;
  int base_n_ = 0;             // odd length that remains
  std::vector<int32_t> base_;  // base_n x base_n, Q30, row k
};

class Poisson {
 public:
  static constexpr int kMaxCells = 640;  // along one axis, from the accumulator bound

  explicit Poisson(const BoardSettings& board);

  void run(std::span<const CellSlope> slope, std::span<DisplacementUm> depth, SaturationCounter& saturations);

 private:
  void gradient(std::span<const CellSlope> slope, SaturationCounter& saturations);
  void divergence();
  void transform_rows();
  void solve_columns(SaturationCounter& saturations);
  void invert_rows(SaturationCounter& saturations);
  void finish(std::span<DisplacementUm> depth, SaturationCounter& saturations) const;

  GridSize grid_;
  int64_t standoff_um_;
  int64_t cell_um_q10_;             // H step / f
  std::vector<int32_t> ray_x_q16_;  // per column
  std::vector<int32_t> ray_y_q16_;  // per row
  std::vector<uint32_t> gauge_cells_;
  CosineTransform transform_;
  std::vector<int32_t> factor_q30_;      // [y][k]: 1 / pivot of all rows but the last, at most 1
  std::vector<int64_t> last_pivot_q30_;  // [k]: small where the wave is long, so it divides
  std::vector<int32_t> gradient_x_;      // Q10
  std::vector<int32_t> gradient_y_;
  std::vector<int64_t> f_;  // divergence, then its transform, then w; Q11
  std::vector<int64_t> row_;
  std::vector<int64_t> work_;
};

}  // namespace ruffini
