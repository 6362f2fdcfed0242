#include "image/photometric.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr int kOne = 16'384;       // Q14
constexpr int kTableFraction = 9;  // bits of q below one table step: 2 * 16384 / 64 = 512

// Place of pixel i of n on a lattice of `lines`, Q16: line and fraction.
struct LatticePlace {
  int line;
  int64_t fraction;
};

LatticePlace lattice_place(int i, int n, int lines) {
  const int64_t t = floor_div(int64_t{i} * (lines - 1) * 65'536, n - 1);
  const int line = static_cast<int>(std::min<int64_t>(t >> 16, lines - 2));
  return {line, t - (int64_t{line} << 16)};
}

int64_t blend(int64_t a, int64_t b, int64_t fraction_q16) { return a * (65'536 - fraction_q16) + b * fraction_q16; }

}  // namespace

Photometric::Photometric(const BoardSettings& board, const PhotometricTable& table)
    : width_px_(board.camera.width_px),
      height_px_(board.camera.height_px),
      step_px_(board.depth.step_px),
      grid_{width_px_ / step_px_, height_px_ / step_px_},
      unmix_(static_cast<size_t>(width_px_ * height_px_) * 6),
      slope_(table.slope.begin(), table.slope.end()),
      is_masked_(static_cast<size_t>(width_px_ * height_px_)),
      is_empty_(static_cast<size_t>(grid_.count())) {
  // Half the diameter, a quarter for stretch and blur, and two pixels for the lens.
  const CameraSettings& camera = board.camera;
  const int64_t diameter_q16 =
      floor_div(board.markers.diameter_um * camera.focal_mpx * 65'536, camera.standoff_um * 1'000);
  mask_radius_q16_ = diameter_q16 * 3 / 4 + 2 * 65'536;
  fill_radius_ = std::max(static_cast<int>((mask_radius_q16_ >> 16) / step_px_), 1);
  for (int y = 0; y < height_px_; ++y) {
    const LatticePlace v = lattice_place(y, height_px_, table.cells.n_y);
    for (int x = 0; x < width_px_; ++x) {
      const LatticePlace u = lattice_place(x, width_px_, table.cells.n_x);
      const int16_t* top = table.unmix.data() + static_cast<size_t>(v.line * table.cells.n_x + u.line) * 6;
      const int16_t* bottom = top + static_cast<size_t>(table.cells.n_x) * 6;
      int16_t* out = unmix_.data() + static_cast<size_t>(y * width_px_ + x) * 6;
      for (int k = 0; k < 6; ++k) {
        const int64_t upper = blend(top[k], top[k + 6], u.fraction);
        const int64_t lower = blend(bottom[k], bottom[k + 6], u.fraction);
        out[k] = static_cast<int16_t>(round_shift(blend(upper, lower, v.fraction), 32));
      }
    }
  }
}

void Photometric::mask_disc(int64_t x_q16, int64_t y_q16) {
  const int64_t r = mask_radius_q16_;
  const int y0 = static_cast<int>(std::max<int64_t>((y_q16 - r) >> 16, 0));
  const int y1 = static_cast<int>(std::min<int64_t>((y_q16 + r) >> 16, height_px_ - 1));
  const int x0 = static_cast<int>(std::max<int64_t>((x_q16 - r) >> 16, 0));
  const int x1 = static_cast<int>(std::min<int64_t>((x_q16 + r) >> 16, width_px_ - 1));
  for (int y = y0; y <= y1; ++y) {
    const int64_t dy = (int64_t{y} << 16) - y_q16;
    for (int x = x0; x <= x1; ++x) {
      const int64_t dx = (int64_t{x} << 16) - x_q16;
      if (dx * dx + dy * dy <= r * r) is_masked_[static_cast<size_t>(y * width_px_ + x)] = 1;
    }
  }
}

void Photometric::mask_markers(std::span<const Marker> markers) {
  std::fill(is_masked_.begin(), is_masked_.end(), uint8_t{0});
  for (const Marker& marker : markers) {
    const int64_t x = marker.rest_x.raw();
    const int64_t y = marker.rest_y.raw();
    mask_disc(x, y);
    mask_disc(x + marker.displacement_x.raw(), y + marker.displacement_y.raw());
  }
}

CellSlope Photometric::pixel_slope(const RelativeChange* d, const int16_t* m) const {
  int64_t q[2];
  for (int k = 0; k < 2; ++k, m += 3) {
    const int64_t sum = int64_t{m[0]} * d[0].raw() + int64_t{m[1]} * d[1].raw() + int64_t{m[2]} * d[2].raw();
    q[k] = std::clamp<int64_t>(round_shift(sum, 10), -kOne, kOne) + kOne;
  }
  const int64_t column = std::min<int64_t>(q[0] >> kTableFraction, kSlopeSize - 2);
  const int64_t row = std::min<int64_t>(q[1] >> kTableFraction, kSlopeSize - 2);
  const int64_t fx = q[0] - (column << kTableFraction);
  const int64_t fy = q[1] - (row << kTableFraction);
  const int16_t* at = slope_.data() + (row * kSlopeSize + column) * 2;
  const auto lookup = [&](int k) {
    const int64_t upper = at[k] * (512 - fx) + at[k + 2] * fx;
    const int64_t lower = at[k + 2 * kSlopeSize] * (512 - fx) + at[k + 2 * kSlopeSize + 2] * fx;
    return Slope::from_raw(static_cast<int16_t>(round_shift(upper * (512 - fy) + lower * fy, 18)));
  };
  return {lookup(0), lookup(1)};
}

void Photometric::fill_masked(std::span<CellSlope> out) {
  for (int y = 0; y < grid_.n_y; ++y) {
    for (int x = 0; x < grid_.n_x; ++x) {
      if (is_empty_[static_cast<size_t>(y * grid_.n_x + x)] == 0) continue;
      int64_t sum_x = 0;
      int64_t sum_y = 0;
      int64_t count = 0;
      for (int r = fill_radius_; count == 0 && r < 2 * (grid_.n_x + grid_.n_y); r *= 2) {
        for (int v = std::max(y - r, 0); v <= std::min(y + r, grid_.n_y - 1); ++v) {
          for (int u = std::max(x - r, 0); u <= std::min(x + r, grid_.n_x - 1); ++u) {
            const auto at = static_cast<size_t>(v * grid_.n_x + u);
            if (is_empty_[at] != 0) continue;
            sum_x += out[at].x.raw();
            sum_y += out[at].y.raw();
            ++count;
          }
        }
      }
      const auto mean = [&](int64_t sum) {
        return Slope::from_raw(count == 0 ? int16_t{0} : static_cast<int16_t>(floor_div(2 * sum + count, 2 * count)));
      };
      out[static_cast<size_t>(y * grid_.n_x + x)] = {mean(sum_x), mean(sum_y)};
    }
  }
}

void Photometric::run(std::span<const RelativeChange> difference, std::span<const Marker> markers,
                      std::span<CellSlope> out) {
  mask_markers(markers);
  for (int cy = 0; cy < grid_.n_y; ++cy) {
    for (int cx = 0; cx < grid_.n_x; ++cx) {
      int64_t sum_x = 0;
      int64_t sum_y = 0;
      int64_t count = 0;
      for (int y = cy * step_px_; y < (cy + 1) * step_px_; ++y) {
        for (int x = cx * step_px_; x < (cx + 1) * step_px_; ++x) {
          const auto at = static_cast<size_t>(y * width_px_ + x);
          if (is_masked_[at] != 0) continue;
          const CellSlope slope = pixel_slope(&difference[at * 3], &unmix_[at * 6]);
          sum_x += slope.x.raw();
          sum_y += slope.y.raw();
          ++count;
        }
      }
      const auto cell = static_cast<size_t>(cy * grid_.n_x + cx);
      is_empty_[cell] = count == 0 ? 1 : 0;
      if (count == 0) continue;
      out[cell] = {Slope::from_raw(static_cast<int16_t>(floor_div(2 * sum_x + count, 2 * count))),
                   Slope::from_raw(static_cast<int16_t>(floor_div(2 * sum_y + count, 2 * count)))};
    }
  }
  fill_masked(out);
}

}  // namespace ruffini
