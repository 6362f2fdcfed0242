#include "image/poisson.h"

#include <algorithm>

#include "image/kernels.h"
#include "image/trigonometry.h"

namespace ruffini {
namespace {

constexpr int64_t kOneQ30 = int64_t{1} << 30;
constexpr int64_t kMaxCellUm = 8'191;  // keeps scaled slopes within 32 bits; larger cells saturate at any slope

size_t padded(int n) {
  return (static_cast<size_t>(n) + PoissonBuffers::kMaxLanes - 1) / PoissonBuffers::kMaxLanes *
         PoissonBuffers::kMaxLanes;
}

// Cells of the ring that the gauge averages: inside the window, within `margin` of its edge.
std::vector<uint32_t> ring(const BoardSettings& board, const PoissonTables& tables) {
  const WindowSettings& w = board.window;
  const int64_t margin = board.depth.margin_um;
  std::vector<uint32_t> cells;
  std::vector<uint32_t> all;
  for (int y = 0; y < tables.grid.n_y; ++y) {
    for (int x = 0; x < tables.grid.n_x; ++x) {
      const int64_t ray_x = tables.ray_x_q16[static_cast<size_t>(x)];
      const int64_t ray_y = tables.ray_y_q16[static_cast<size_t>(y)];
      const int64_t x_um = (ray_x * board.camera.standoff_um >> 16) + board.pad.size_x_um / 2;
      const int64_t y_um = (ray_y * board.camera.standoff_um >> 16) + board.pad.size_y_um / 2;
      const int64_t depth = std::min({x_um - w.min_x_um, w.max_x_um - x_um, y_um - w.min_y_um, w.max_y_um - y_um});
      all.push_back(static_cast<uint32_t>(static_cast<size_t>(y) * tables.stride + static_cast<size_t>(x)));
      if (depth < 0 || (board.depth.gauge == Gauge::kMargin && depth >= margin)) continue;
      cells.push_back(all.back());
    }
  }
  return cells.empty() ? all : cells;  // a ring thinner than a cell: the whole image
}

// Slope of the ray through the centre of each cell, Q16.
std::vector<int32_t> ray_slopes(int n, int step, int64_t center_mpx, int64_t focal_mpx) {
  std::vector<int32_t> rays(static_cast<size_t>(n));
  for (int i = 0; i < n; ++i) {
    const int64_t middle_mpx = (int64_t{2} * i * step + step - 1) * 500;
    rays[static_cast<size_t>(i)] = static_cast<int32_t>(floor_div((middle_mpx - center_mpx) * 65'536, focal_mpx));
  }
  return rays;
}

// 1 / x for x in Q14 at every 2^kFoldStep. Values below 0.1 are never read and equal that at 0.1.
std::vector<int32_t> inverse_table() {
  std::vector<int32_t> lines(PoissonTables::kFoldLines);
  for (int i = 0; i < PoissonTables::kFoldLines; ++i) {
    const int64_t x_q14 = std::max(int64_t{i} << PoissonTables::kFoldStep, int64_t{1} << 10);
    lines[static_cast<size_t>(i)] = static_cast<int32_t>(floor_div((int64_t{1} << 39) + x_q14, 2 * x_q14));
  }
  return lines;
}

}  // namespace

PoissonTables::PoissonTables(const BoardSettings& board)
    : grid{board.camera.width_px / board.depth.step_px, board.camera.height_px / board.depth.step_px},
      stride(padded(grid.n_x)),
      cell_um_q10(static_cast<int32_t>(
          std::min(floor_div(board.camera.standoff_um * board.depth.step_px * 1'024 * 1'000, board.camera.focal_mpx),
                   kMaxCellUm * 1'024))),
      ray_x_q16(ray_slopes(grid.n_x, board.depth.step_px, board.camera.center_x_mpx, board.camera.focal_mpx)),
      ray_y_q16(ray_slopes(grid.n_y, board.depth.step_px, board.camera.center_y_mpx, board.camera.focal_mpx)),
      inverse_q24(inverse_table()),
      cosine(grid.n_x),
      factor_q31(static_cast<size_t>(grid.n_y) * stride),
      last_pivot_q30(static_cast<size_t>(grid.n_x)),
      gauge_cells(ring(board, *this)),
      inverse_2h(static_cast<int32_t>(floor_div(int64_t{1} << 36, 2 * board.camera.standoff_um))),
      inverse_3h(static_cast<int32_t>(floor_div(int64_t{1} << 36, 3 * board.camera.standoff_um))) {
  for (int k = 1; k < grid.n_x; ++k) {
    const int64_t eigenvalue = 2 * (kOneQ30 - cos_pi_q30(k, grid.n_x));
    int64_t factor = 0;
    for (int y = 0; y + 1 < grid.n_y; ++y) {
      factor = floor_div(int64_t{1} << 60, (y > 0 ? 2 : 1) * kOneQ30 + eigenvalue - factor);
      factor_q31[static_cast<size_t>(y) * stride + static_cast<size_t>(k)] = static_cast<int32_t>(2 * factor);
    }
    last_pivot_q30[static_cast<size_t>(k)] = kOneQ30 + eigenvalue - factor;
  }
}

PoissonBuffers::PoissonBuffers(const PoissonTables& tables)
    : stride(tables.stride),
      gradient_x(static_cast<size_t>(tables.grid.n_y) * (tables.stride + 2 * kMargin)),
      gradient_y(static_cast<size_t>(tables.grid.n_y + 2) * tables.stride),
      f(padded(tables.grid.n_y) * tables.stride),
      column(padded(tables.grid.n_y)),
      work(5 * tables.stride * kMaxLanes + kMaxLanes) {}

Poisson::Poisson(const BoardSettings& board, PoissonRun version) : tables_(board), buffers_(tables_), run_(version) {}

Poisson::Poisson(const BoardSettings& board) : Poisson(board, kernels::fastest_supported().poisson) {}

}  // namespace ruffini
