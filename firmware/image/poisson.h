// Surface slope -> depth: exact discrete Poisson solve with free (Neumann) borders, in perspective.
//
// The gradient of w = H ln(1 + z/H), micrometres per cell, Q10, clamped to +-2^20 (firmware/DESIGN.md):
//
//   e = (s_x x' + s_y y' + 2^13) >> 14, clamped to [-1, 0.9]  Q14; x', y': slopes of the ray, Q16
//   g = s (H step / f) / (1 - e)                           1 / (1 - e) from a table, linear between its lines
//
// averaged to the midpoints between cells (kept doubled, so Q11), its divergence f; then
//
//   1. F = cosine transform of f along x (cosine_transform.h)
//   2. per wave number k, tridiagonal solve along y with the exact eigenvalue 2 - 2 cos(pi k / n_x), k from 0;
//      k = 0 is a plain double sum
//   3. w = inverse transform
//   4. gauge: minus the mean over the gauge cells; z = w + w^2 / (2 H) + w^3 / (6 H^2)
//
// Between 1 and 2, and after 2, values are Q8 of n_x / 2 times the height of a wave. Inside the transforms they have an
// additional power of two common to all cells, up to the bound of cosine_transform.h. A field that is a gradient at the
// midpoints is reproduced up to rounding (below 20 nm). Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "image/cosine_transform.h"
#include "image/photometric.h"

namespace ruffini {

// Constants of the solve, computed once for a board.
struct PoissonTables {
  static constexpr int kFoldStep = 6;                             // bits of 1 - e, Q14, below one line of the table
  static constexpr int kFoldLines = (2 << (14 - kFoldStep)) + 2;  // up to 1 - e = 2, and one beyond

  explicit PoissonTables(const BoardSettings& board);

  GridSize grid;
  size_t stride;                     // of a row of `factor` and of the buffers, cells; a multiple of the lanes
  int32_t cell_um_q10;               // H step / f
  std::vector<int32_t> ray_x_q16;    // per column
  std::vector<int32_t> ray_y_q16;    // per row
  std::vector<int32_t> inverse_q24;  // [kFoldLines] of 1 - e
  CosineTables cosine;
  std::vector<int32_t> factor_q31;      // [y][k]: 1 / pivot of all rows but the last, below 1; zero where k = 0
  std::vector<int64_t> last_pivot_q30;  // [k]: small for long waves, therefore divided by
  std::vector<uint32_t> gauge_cells;    // y stride + x
  int32_t inverse_2h;                   // 2^36 / (2 H)
  int32_t inverse_3h;                   // 2^36 / (3 H)
};

// Buffers of the solve. Rows are padded with zeros to the stride, and their number to a multiple of the lanes.
struct PoissonBuffers {
  static constexpr size_t kMaxLanes = 8;
  static constexpr size_t kMargin = 8;  // before the first cell of a row of gradient_x, for its mirror image

  explicit PoissonBuffers(const PoissonTables& tables);

  int32_t* row_x(size_t y) { return gradient_x.data() + y * (stride + 2 * kMargin) + kMargin; }
  int32_t* row_y(size_t y) { return gradient_y.data() + (y + 1) * stride; }
  int32_t* row_f(size_t y) { return f.data() + y * stride; }

  size_t stride;

  std::vector<int32_t> gradient_x;  // Q10, rows of stride + 2 kMargin
  std::vector<int32_t> gradient_y;  // Q10, rows of stride, with one more row before the first and after the last
  std::vector<int32_t> f;           // divergence, then its transform, then w
  std::vector<int32_t> column;      // k = 0, padded as the rows' number
  std::vector<int32_t> work;        // of the transforms
};

using PoissonRun = void (*)(const PoissonTables&, PoissonBuffers&, std::span<const CellSlope> slope,
                            std::span<DisplacementUm> depth, SaturationCounter& saturations);

class Poisson {
 public:
  static constexpr int kMaxCells = 640;  // along one axis: n max|f| = 640 2^23 has 33 bits

  Poisson(const BoardSettings& board, PoissonRun version);
  explicit Poisson(const BoardSettings& board);  // the fastest version that this processor supports

  void run(std::span<const CellSlope> slope, std::span<DisplacementUm> depth, SaturationCounter& saturations) {
    run_(tables_, buffers_, slope, depth, saturations);
  }

 private:
  PoissonTables tables_;
  PoissonBuffers buffers_;
  PoissonRun run_;
};

}  // namespace ruffini
