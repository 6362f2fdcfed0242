#include "image/poisson.h"

#include <algorithm>

#include "image/trigonometry.h"

namespace ruffini {
namespace {

constexpr int64_t kOneQ14 = 16'384;
constexpr int64_t kMaxFold = kOneQ14 * 9 / 10;      // steeper than the ray: the surface would hide itself
constexpr int64_t kMaxGradient = int64_t{1} << 20;  // Q10: 1 mm per cell
constexpr int64_t kMaxWave = int64_t{1} << 26;      // Q13: 8 mm

int64_t clamp_counted(int64_t x, int64_t limit, SaturationCounter& saturations) {
  if (x < -limit || x > limit) {
    ++saturations.count;
    return x < 0 ? -limit : limit;
  }
  return x;
}

// x / pivot with the pivot in Q30, half up. Precondition: |x| < 2^32.
int64_t divide_q30(int64_t x, int64_t pivot) { return floor_div(x * (int64_t{1} << 30) + pivot / 2, pivot); }

// Cells of the ring that the gauge averages: inside the window, within margin of its edge.
std::vector<uint32_t> ring(const BoardSettings& board, GridSize grid, std::span<const int32_t> ray_x,
                           std::span<const int32_t> ray_y) {
  const WindowSettings& w = board.window;
  const int64_t margin = board.depth.margin_um;
  std::vector<uint32_t> cells;
  for (int y = 0; y < grid.n_y; ++y) {
    for (int x = 0; x < grid.n_x; ++x) {
      const int64_t x_um = (ray_x[static_cast<size_t>(x)] * board.camera.standoff_um >> 16) + board.pad.size_x_um / 2;
      const int64_t y_um = (ray_y[static_cast<size_t>(y)] * board.camera.standoff_um >> 16) + board.pad.size_y_um / 2;
      const int64_t depth = std::min({x_um - w.min_x_um, w.max_x_um - x_um, y_um - w.min_y_um, w.max_y_um - y_um});
      if (depth < 0 || (board.depth.gauge == Gauge::kMargin && depth >= margin)) continue;
      cells.push_back(static_cast<uint32_t>(y * grid.n_x + x));
    }
  }
  if (cells.empty()) {  // a ring thinner than a cell: the whole image
    for (int i = 0; i < grid.count(); ++i) cells.push_back(static_cast<uint32_t>(i));
  }
  return cells;
}

// Slope of the ray through the middle of each cell, Q16.
std::vector<int32_t> ray_slopes(int n, int step, int64_t center_mpx, int64_t focal_mpx) {
  std::vector<int32_t> rays(static_cast<size_t>(n));
  for (int i = 0; i < n; ++i) {
    const int64_t middle_mpx = (int64_t{2} * i * step + step - 1) * 500;
    rays[static_cast<size_t>(i)] = static_cast<int32_t>(floor_div((middle_mpx - center_mpx) * 65'536, focal_mpx));
  }
  return rays;
}

}  // namespace

CosineTransform::CosineTransform(int n) {
  while (n % 2 == 0) {
    Level level{n, {}};
    for (int k = 0; k < n / 2; ++k) {
      for (int i = 0; i < n / 2; ++i) level.odd.push_back(cos_pi_q30(int64_t{2 * k + 1} * (2 * i + 1), 2 * n));
    }
    levels_.push_back(std::move(level));
    n /= 2;
  }
  base_n_ = n;
  for (int k = 0; k < n; ++k) {
    for (int i = 0; i < n; ++i) base_.push_back(cos_pi_q30(int64_t{k} * (2 * i + 1), 2 * n));
  }
}

void CosineTransform::forward(const int64_t* in, int64_t* out, int64_t* work) const {
  forward_level(0, in, out, 1, work);
}

void CosineTransform::forward_level(size_t level, const int64_t* in, int64_t* out, int stride, int64_t* work) const {
  if (level == levels_.size()) {
    for (int k = 0; k < base_n_; ++k) {
      int64_t sum = 0;
      for (int i = 0; i < base_n_; ++i) sum += base_[static_cast<size_t>(k * base_n_ + i)] * in[i];
      out[k * stride] = round_shift(sum, 30);
    }
    return;
  }
  const int half = levels_[level].n / 2;
  int64_t* sums = work;
  int64_t* differences = work + half;
  for (int i = 0; i < half; ++i) {
    sums[i] = in[i] + in[2 * half - 1 - i];
    differences[i] = in[i] - in[2 * half - 1 - i];
  }
  const int32_t* row = levels_[level].odd.data();
  for (int k = 0; k < half; ++k, row += half) {
    int64_t sum = 0;
    for (int i = 0; i < half; ++i) sum += row[i] * differences[i];
    out[(2 * k + 1) * stride] = round_shift(sum, 30);
  }
  forward_level(level + 1, sums, out, 2 * stride, work + half);
}

void CosineTransform::inverse(const int64_t* in, int64_t* out, int64_t* work) const {
  inverse_level(0, in, 1, out, work);
}

void CosineTransform::inverse_level(size_t level, const int64_t* in, int stride, int64_t* out, int64_t* work) const {
  if (level == levels_.size()) {
    for (int i = 0; i < base_n_; ++i) {
      int64_t sum = 0;
      for (int k = 0; k < base_n_; ++k) sum += (base_[static_cast<size_t>(k * base_n_ + i)] >> 3) * in[k * stride];
      out[i] = round_shift(sum, 27);
    }
    return;
  }
  const int half = levels_[level].n / 2;
  inverse_level(level + 1, in, 2 * stride, work, work + half);
  const int32_t* row = levels_[level].odd.data();
  for (int i = 0; i < half; ++i, row += half) {  // the odd matrix is symmetric: row i serves as column i
    int64_t sum = 0;
    for (int k = 0; k < half; ++k) sum += (row[k] >> 3) * in[(2 * k + 1) * stride];
    const int64_t odd = round_shift(sum, 27);
    out[i] = work[i] + odd;
    out[2 * half - 1 - i] = work[i] - odd;
  }
}

Poisson::Poisson(const BoardSettings& board)
    : grid_{board.camera.width_px / board.depth.step_px, board.camera.height_px / board.depth.step_px},
      standoff_um_(board.camera.standoff_um),
      cell_um_q10_(floor_div(standoff_um_ * board.depth.step_px * 1'024 * 1'000, board.camera.focal_mpx)),
      ray_x_q16_(ray_slopes(grid_.n_x, board.depth.step_px, board.camera.center_x_mpx, board.camera.focal_mpx)),
      ray_y_q16_(ray_slopes(grid_.n_y, board.depth.step_px, board.camera.center_y_mpx, board.camera.focal_mpx)),
      gauge_cells_(ring(board, grid_, ray_x_q16_, ray_y_q16_)),
      transform_(grid_.n_x),
      factor_q30_(static_cast<size_t>(grid_.count())),
      last_pivot_q30_(static_cast<size_t>(grid_.n_x)),
      gradient_x_(static_cast<size_t>(grid_.count())),
      gradient_y_(static_cast<size_t>(grid_.count())),
      f_(static_cast<size_t>(grid_.count())),
      row_(static_cast<size_t>(grid_.n_x)),
      work_(static_cast<size_t>(2 * grid_.n_x)) {
  constexpr int64_t kOneQ30 = int64_t{1} << 30;
  for (int k = 1; k < grid_.n_x; ++k) {
    const int64_t eigenvalue = 2 * (kOneQ30 - cos_pi_q30(k, grid_.n_x));
    int64_t factor = 0;
    for (int y = 0; y + 1 < grid_.n_y; ++y) {
      factor = floor_div(int64_t{1} << 60, (y > 0 ? 2 : 1) * kOneQ30 + eigenvalue - factor);
      factor_q30_[static_cast<size_t>(y * grid_.n_x + k)] = static_cast<int32_t>(factor);
    }
    last_pivot_q30_[static_cast<size_t>(k)] = kOneQ30 + eigenvalue - factor;
  }
}

void Poisson::gradient(std::span<const CellSlope> slope, SaturationCounter& saturations) {
  size_t at = 0;
  for (int y = 0; y < grid_.n_y; ++y) {
    const int64_t ray_y = ray_y_q16_[static_cast<size_t>(y)];
    for (int x = 0; x < grid_.n_x; ++x, ++at) {
      const int64_t sx = slope[at].x.raw();
      const int64_t sy = slope[at].y.raw();
      const int64_t e = std::min(round_shift(sx * ray_x_q16_[static_cast<size_t>(x)] + sy * ray_y, 14), kMaxFold);
      const int64_t inverse_q16 = (int64_t{1} << 30) / (kOneQ14 - e);
      const int64_t scale = inverse_q16 * cell_um_q10_;  // Q26
      gradient_x_[at] = static_cast<int32_t>(clamp_counted(round_shift(sx * scale, 28), kMaxGradient, saturations));
      gradient_y_[at] = static_cast<int32_t>(clamp_counted(round_shift(sy * scale, 28), kMaxGradient, saturations));
    }
  }
}

void Poisson::divergence() {
  const int nx = grid_.n_x;
  for (int y = 0; y < grid_.n_y; ++y) {
    for (int x = 0; x < nx; ++x) {
      const int at = y * nx + x;
      const auto gx = [&](int i) { return int64_t{gradient_x_[static_cast<size_t>(i)]}; };
      const auto gy = [&](int i) { return int64_t{gradient_y_[static_cast<size_t>(i)]}; };
      const int64_t right = x + 1 < nx ? gx(at) + gx(at + 1) : 0;
      const int64_t left = x > 0 ? gx(at - 1) + gx(at) : 0;
      const int64_t below = y + 1 < grid_.n_y ? gy(at) + gy(at + nx) : 0;
      const int64_t above = y > 0 ? gy(at - nx) + gy(at) : 0;
      f_[static_cast<size_t>(at)] = right - left + below - above;
    }
  }
}

void Poisson::transform_rows() {
  for (int y = 0; y < grid_.n_y; ++y) {
    int64_t* line = f_.data() + static_cast<size_t>(y) * static_cast<size_t>(grid_.n_x);
    std::copy(line, line + grid_.n_x, row_.begin());
    transform_.forward(row_.data(), line, work_.data());
  }
}

void Poisson::solve_columns(SaturationCounter& saturations) {
  const auto nx = static_cast<size_t>(grid_.n_x);
  const auto line = [&](int y) { return f_.data() + static_cast<size_t>(y) * nx; };
  const auto factor = [&](int y) { return factor_q30_.data() + static_cast<size_t>(y) * nx; };
  // k = 0: the row sums' flux, summed once more.
  int64_t flux = 0;
  int64_t height = 0;
  for (int y = 0; y < grid_.n_y; ++y) {
    flux += line(y)[0];
    line(y)[0] = saturate_raw<int32_t>(height, saturations);
    height += flux;
  }
  for (int y = 0; y < grid_.n_y; ++y) {
    for (size_t k = 1; k < nx; ++k) {
      const int64_t above = y > 0 ? line(y - 1)[k] : 0;
      const int64_t sum = saturate_raw<int32_t>(above - line(y)[k], saturations);
      line(y)[k] = y + 1 < grid_.n_y ? round_shift(sum * factor(y)[k], 30)
                                     : saturate_raw<int32_t>(divide_q30(sum, last_pivot_q30_[k]), saturations);
    }
  }
  for (int y = grid_.n_y - 2; y >= 0; --y) {
    for (size_t k = 1; k < nx; ++k) {
      const int64_t below = line(y + 1)[k];
      line(y)[k] = saturate_raw<int32_t>(line(y)[k] + round_shift(below * factor(y)[k], 30), saturations);
    }
  }
}

// v = 4 z_k 2 / n (1 / n for k = 0), so that two more fraction bits go through the transform.
void Poisson::invert_rows(SaturationCounter& saturations) {
  const int64_t n = grid_.n_x;
  for (int y = 0; y < grid_.n_y; ++y) {
    int64_t* line = f_.data() + static_cast<size_t>(y) * static_cast<size_t>(n);
    for (int64_t k = 0; k < n; ++k) {
      const int64_t scaled = floor_div(line[k] * (k == 0 ? 8 : 16) + n, 2 * n);
      row_[static_cast<size_t>(k)] = clamp_counted(scaled, kMaxWave, saturations);
    }
    transform_.inverse(row_.data(), line, work_.data());
    for (int64_t x = 0; x < n; ++x) line[x] = round_shift(line[x], 2);
  }
}

void Poisson::finish(std::span<DisplacementUm> depth, SaturationCounter& saturations) const {
  int64_t sum = 0;
  for (const uint32_t cell : gauge_cells_) sum += f_[cell];
  const int64_t mean = floor_div(sum, static_cast<int64_t>(gauge_cells_.size()));
  const int64_t inverse_2h = floor_div(int64_t{1} << 40, 2 * standoff_um_);
  const int64_t inverse_3h = floor_div(int64_t{1} << 40, 3 * standoff_um_);
  for (size_t i = 0; i < depth.size(); ++i) {
    const int64_t w = clamp_counted(f_[i] - mean, int64_t{1} << 24, saturations);
    const int64_t second = round_shift(round_shift(w * w, 11) * inverse_2h, 40);
    const int64_t third = round_shift(round_shift(second * w, 11) * inverse_3h, 40);
    depth[i] = narrow<DisplacementUm, 11>(w + second + third, saturations);
  }
}

void Poisson::run(std::span<const CellSlope> slope, std::span<DisplacementUm> depth, SaturationCounter& saturations) {
  gradient(slope, saturations);
  divergence();
  transform_rows();
  solve_columns(saturations);
  invert_rows(saturations);
  finish(depth, saturations);
}

}  // namespace ruffini
