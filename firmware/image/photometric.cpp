#include "image/photometric.h"

#include <algorithm>

#include "image/kernels.h"

namespace ruffini {
namespace {

// Position of the centre of cell i, of `step` pixels, on a lattice of `lines` over n pixels; Q16: line and fraction.
struct LatticePlace {
  int line;
  int64_t fraction;
};

LatticePlace lattice_place(int i, int step, int n, int lines) {
  const int64_t t = floor_div((int64_t{2} * i * step + step - 1) * (lines - 1) * 65'536, int64_t{2} * (n - 1));
  const int line = static_cast<int>(std::min<int64_t>(t >> 16, lines - 2));
  return {line, t - (int64_t{line} << 16)};
}

constexpr int kBendFraction = 9;  // bits between two lines of the bend

int64_t blend(int64_t a, int64_t b, int64_t fraction_q16) { return a * (65'536 - fraction_q16) + b * fraction_q16; }

// Interpolates the lattice at the centre of every cell: six planes.
std::vector<int16_t> unmix_of_cells(const BoardSettings& board, GridSize grid, const PhotometricTable& table) {
  const auto n = static_cast<size_t>(grid.count());
  std::vector<int16_t> out(6 * n);
  if (table.unmix.empty()) return out;
  for (int y = 0; y < grid.n_y; ++y) {
    const LatticePlace v = lattice_place(y, board.depth.step_px, board.camera.height_px, table.cells.n_y);
    for (int x = 0; x < grid.n_x; ++x) {
      const LatticePlace u = lattice_place(x, board.depth.step_px, board.camera.width_px, table.cells.n_x);
      const int16_t* top = table.unmix.data() + static_cast<size_t>(v.line * table.cells.n_x + u.line) * 6;
      const int16_t* bottom = top + static_cast<size_t>(table.cells.n_x) * 6;
      for (size_t k = 0; k < 6; ++k) {
        const int64_t upper = blend(top[k], top[k + 6], u.fraction);
        const int64_t lower = blend(bottom[k], bottom[k + 6], u.fraction);
        out[k * n + static_cast<size_t>(y * grid.n_x + x)] =
            static_cast<int16_t>(round_shift(blend(upper, lower, v.fraction), 32));
      }
    }
  }
  return out;
}

std::vector<int32_t> packed(std::span<const int16_t> slope) {
  std::vector<int32_t> out(slope.size() / 2);
  for (size_t i = 0; i < out.size(); ++i) {
    const auto x = static_cast<uint16_t>(slope[2 * i]);
    const auto y = static_cast<uint16_t>(slope[2 * i + 1]);
    out[i] = static_cast<int32_t>(x | uint32_t{y} << 16);
  }
  return out;
}

}  // namespace

Photometric::Photometric(const BoardSettings& board, const PhotometricTable& table, CellRun version)
    : width_px_(board.camera.width_px),
      height_px_(board.camera.height_px),
      step_px_(board.depth.step_px),
      grid_{width_px_ / step_px_, height_px_ / step_px_},
      run_(version),
      unmix_(unmix_of_cells(board, grid_, table)),
      slope_(packed(table.slope)),
      bend_(packed(table.bend)),
      depth_(table.depth.begin(), table.depth.end()),
      is_balanced_(table.is_balanced),
      keep_(static_cast<size_t>(width_px_ * height_px_)),
      n_kept_(static_cast<size_t>(grid_.count())),
      fill_(grid_) {
  // Half the diameter, plus an eighth for ink and stretch, plus one pixel for the lens: outside it the dots of the
  // recorded GelSight Mini video darken less than 1 %, even pressed and sheared. A wider mask costs depth at steep
  // walls.
  const bool are_targets = board.markers.lattice.count() == 0;  // targets hide the surface and are closer to the camera
  const int64_t diameter_um = are_targets ? board.targets.diameter_um : board.markers.diameter_um;
  const int64_t distance_um = board.camera.standoff_um - (are_targets ? board.targets.below_um : 0);
  const int64_t diameter_q16 = floor_div(diameter_um * board.camera.focal_mpx * 65'536, distance_um * 1'000);
  mask_radius_q16_ = diameter_q16 * 5 / 8 + 65'536;
  for (size_t c = 0; c < 3; ++c) {
    bend_low_q16_[c] = table.bend_low_q12[c] * 16;
    bend_shift_[c] = table.bend_shift[c] + 4 - kBendFraction;
  }
}

Photometric::Photometric(const BoardSettings& board, const PhotometricTable& table)
    : Photometric(board, table, kernels::fastest_supported().cells) {}

// Row by row: the disc's extent to the left and right follows from that of the row above.
void Photometric::mask_disc(int64_t x_q16, int64_t y_q16) {
  const int64_t r = mask_radius_q16_;
  const auto y0 = std::max<int64_t>((y_q16 - r) >> 16, 0);
  const auto y1 = std::min<int64_t>((y_q16 + r) >> 16, height_px_ - 1);
  int64_t left = (x_q16 >> 16) + 1;  // no pixel yet
  int64_t right = left - 1;
  for (int64_t y = y0; y <= y1; ++y) {
    const int64_t dy = (y << 16) - y_q16;
    const auto is_inside = [&](int64_t x) {
      const int64_t dx = (x << 16) - x_q16;
      return dx * dx + dy * dy <= r * r;
    };
    while (left <= right && !is_inside(left)) ++left;
    while (right >= left && !is_inside(right)) --right;
    if (left > right) {
      left = (x_q16 >> 16) + 1;
      right = left - 1;
    }
    while (is_inside(left - 1)) --left;
    while (is_inside(right + 1)) ++right;
    const int64_t from = std::max<int64_t>(left, 0);
    const int64_t to = std::min<int64_t>(right + 1, width_px_);
    if (from < to)
      std::fill(&keep_[static_cast<size_t>(y * width_px_ + from)], &keep_[static_cast<size_t>(y * width_px_)] + to,
                int16_t{0});
  }
}

void Photometric::mask_markers(std::span<const Marker> markers) {
  std::fill(keep_.begin(), keep_.end(), int16_t{-1});
  for (const Marker& marker : markers) {
    const int64_t x = marker.rest_x.raw();
    const int64_t y = marker.rest_y.raw();
    mask_disc(x, y);
    mask_disc(x + marker.displacement_x.raw(), y + marker.displacement_y.raw());
  }
}

// 2^20 / (n (1 + m)) and m / (1 + m), both half up.
void Photometric::set_level(const LightLevel& level) {
  constexpr int64_t kOneQ16 = 65'536;
  for (size_t c = 0; c < 3; ++c) {
    const int64_t light = kOneQ16 + level[c];
    for (int64_t n = 1; n <= 16; ++n) {
      per_count_[c][static_cast<size_t>(n)] =
          static_cast<int32_t>(floor_div((int64_t{2} << 36) + n * light, 2 * n * light));
    }
    level_q16_[c] = static_cast<int32_t>(floor_div(2 * kOneQ16 * level[c] + light, 2 * light));
  }
}

void Photometric::run(std::span<const RelativeChange> difference, std::span<const Marker> markers,
                      const LightLevel& level, std::span<CellSlope> out) {
  mask_markers(markers);
  set_level(is_balanced_ ? level : LightLevel{});
  CellRow row{.step_px = step_px_,
              .n_cells = grid_.n_x,
              .width = width_px_,
              .plane = ptrdiff_t{width_px_} * height_px_,
              .change = reinterpret_cast<const int16_t*>(difference.data()),
              .keep = keep_.data(),
              .unmix_plane = grid_.count(),
              .unmix = unmix_.data(),
              .slope = slope_.data(),
              .bend = bend_.empty() ? nullptr : bend_.data(),
              .bend_low_q16 = bend_low_q16_,
              .bend_shift = bend_shift_,
              .per_count = per_count_.data(),
              .level_q16 = level_q16_,
              .out = out.data(),
              .n_kept = n_kept_.data()};
  for (int y = 0; y < grid_.n_y; ++y) {
    run_(row);
    row.change += step_px_ * row.width;
    row.keep += step_px_ * row.width;
    row.unmix += grid_.n_x;
    row.out += grid_.n_x;
    row.n_kept += grid_.n_x;
  }
  fill_.run(n_kept_, out);
}

void Photometric::run_depth(std::span<const RelativeChange> difference, const LightLevel& level,
                            std::span<DisplacementUm> out) {
  constexpr int64_t kOneQ16 = 65'536;
  constexpr int64_t kLineQ16 = 3 * 2 * kOneQ16 / (PhotometricTable::kDepthSize - 1);  // of the sum over three channels
  set_level(is_balanced_ ? level : LightLevel{});
  const size_t plane = keep_.size();
  const auto n = static_cast<size_t>(step_px_ * step_px_);
  for (int i = 0; i < grid_.count(); ++i) {
    const auto first = static_cast<size_t>(i / grid_.n_x * step_px_ * width_px_ + i % grid_.n_x * step_px_);
    int64_t change = 0;
    for (size_t c = 0; c < 3; ++c) {
      int64_t sum = 0;
      for (int y = 0; y < step_px_; ++y) {
        const auto* row = &difference[c * plane + first + static_cast<size_t>(y * width_px_)];
        for (int x = 0; x < step_px_; ++x) sum += row[x].raw();
      }
      change += round_shift(sum * per_count_[c][n], 16) - level_q16_[c];
    }
    const int64_t t = std::clamp<int64_t>(change + 3 * kOneQ16, 0, 6 * kOneQ16);
    const auto line = static_cast<size_t>(std::min<int64_t>(t / kLineQ16, PhotometricTable::kDepthSize - 2));
    const int64_t fraction = t - static_cast<int64_t>(line) * kLineQ16;
    const int64_t z = depth_[line] * (kLineQ16 - fraction) + depth_[line + 1] * fraction;
    out[static_cast<size_t>(i)] =
        DisplacementUm::from_raw(static_cast<int16_t>(floor_div(2 * z + kLineQ16, 2 * kLineQ16)));
  }
}

}  // namespace ruffini
