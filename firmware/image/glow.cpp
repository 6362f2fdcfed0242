#include "image/glow.h"

#include <algorithm>

#include "image/kernels.h"

namespace ruffini {

void glow_row_scalar(const GlowRow& row, int first) {
  for (int x = first; x < row.width; ++x) {
    const uint8_t* pixel = row.pixels + ptrdiff_t{3} * x;
    const int sum = row.weight[0] * pixel[0] + row.weight[1] * pixel[1] + row.weight[2] * pixel[2];
    row.glow[x] = static_cast<int16_t>(4 * sum - row.base[x]);
  }
}

void smooth_line_scalar(const SmoothLine& line, int first) {
  for (int x = first; x < line.width; ++x) {
    int sum = (line.in[kSmoothReach][x] * kSmoothTap[0] + (1 << 14)) >> 15;
    for (size_t k = 1; k <= kSmoothReach; ++k) {
      const int pair = line.in[kSmoothReach - k][x] + line.in[kSmoothReach + k][x];
      sum += (pair * kSmoothTap[k] + (1 << 14)) >> 15;
    }
    line.out[x] = static_cast<int16_t>(sum);
  }
}

Glow::Glow(const BoardSettings& board, GlowRun glow_run, SmoothRun smooth_run)
    : width_px_(board.camera.width_px),
      height_px_(board.camera.height_px),
      glow_run_(glow_run),
      smooth_run_(smooth_run),
      base_(static_cast<size_t>(width_px_ * height_px_)),
      glow_(base_.size()),
      smoothed_(base_.size()),
      line_(static_cast<size_t>(width_px_ + 2 * kSmoothReach)) {
  for (size_t c = 0; c < 3; ++c) weight_[c] = static_cast<int16_t>(board.skin.weights[c]);
}

Glow::Glow(const BoardSettings& board)
    : Glow(board, kernels::fastest_supported().glow, kernels::fastest_supported().smooth) {}

void Glow::learn(std::span<const uint16_t> rest) {
  constexpr int kMaxRest = 16 * 255;  // a stored image may contain larger values
  for (size_t i = 0; i < base_.size(); ++i) {
    int sum = 0;
    for (size_t c = 0; c < 3; ++c) sum += weight_[c] * std::min<int>(rest[3 * i + c], kMaxRest);
    base_[i] = static_cast<int16_t>((sum + 2) >> 2);
  }
}

void Glow::run(const FrameView& frame) {
  for (int y = 0; y < height_px_; ++y) {
    const ptrdiff_t at = ptrdiff_t{y} * width_px_;
    glow_run_({.pixels = frame.row(y),
               .width = width_px_,
               .weight = weight_,
               .base = base_.data() + at,
               .glow = glow_.data() + at});
  }
}

void Glow::smooth() {
  int16_t* const line = line_.data() + kSmoothReach;
  for (int y = 0; y < height_px_; ++y) {
    SmoothLine down{.width = width_px_, .out = line};
    SmoothLine along{.width = width_px_, .out = smoothed_.data() + ptrdiff_t{y} * width_px_};
    for (int k = -kSmoothReach; k <= kSmoothReach; ++k) {
      const auto i = static_cast<size_t>(k + kSmoothReach);
      down.in[i] = glow_.data() + ptrdiff_t{std::clamp(y + k, 0, height_px_ - 1)} * width_px_;
      along.in[i] = line + k;
    }
    smooth_run_(down);
    std::fill_n(line_.begin(), kSmoothReach, line[0]);
    std::fill_n(line_.end() - kSmoothReach, kSmoothReach, line[width_px_ - 1]);
    smooth_run_(along);
  }
}

}  // namespace ruffini
