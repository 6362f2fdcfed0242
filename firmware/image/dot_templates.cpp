#include "image/dot_templates.h"

#include <algorithm>
#include <bit>

#include "base/fixed.h"
#include "image/kernels.h"

namespace ruffini {
namespace {

constexpr int64_t kMinContrast = 576;     // squared Q4 gradient per pixel: 1.5 grey levels per pixel
constexpr int64_t kMaxStep = 1 << 16;     // Q16 px
constexpr int64_t kMaxInverse = 1 << 30;  // K times two sums below 2^31 stays below 2^62
constexpr int64_t kMaxGradient = 2'047;
constexpr int64_t kMinError2 = 7;      // (0.01 px)^2, Q16
constexpr int64_t kCentreError2 = 41;  // (0.025 px)^2: error of the weighted centre alone

int64_t luma(int64_t b, int64_t g, int64_t r) { return 117 * b + 601 * g + 306 * r; }
int64_t div_round(int64_t a, int64_t n) { return floor_div(2 * a + n, 2 * n); }

int64_t product(const std::vector<int64_t>& a, const std::vector<int64_t>& b) {
  int64_t sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

// Subtracts from `from` its projection on `base`.
void free_of(const std::vector<int64_t>& base, std::vector<int64_t>& from) {
  const int64_t share_q16 = floor_div(product(from, base) * 65'536, std::max<int64_t>(product(base, base), 1));
  for (size_t i = 0; i < from.size(); ++i) from[i] -= round_shift(base[i] * share_q16, 16);
}

}  // namespace

DotTemplates::DotTemplates(const BoardSettings& board) : DotTemplates(board, kernels::fastest_supported().dot_sums) {}

DotTemplates::DotTemplates(const BoardSettings& board, DotSumsRun version)
    : width_px_(board.camera.width_px), height_px_(board.camera.height_px), run_(version) {
  const int64_t radius_q16 =
      floor_div(board.markers.diameter_um * board.camera.focal_mpx * 32'768, board.camera.standoff_um * 1'000);
  // 1.5 px more, rounded to the nearest whole number
  radius_px_ = static_cast<int>((radius_q16 + 2 * 65'536) >> 16);
  if (radius_px_ > kMaxRadiusPx) radius_px_ = 0;
  const int side = 2 * radius_px_ + 2;
  keep_.resize(
      static_cast<size_t>(((side - 1) * side + DotWindow::kLanes - 1) / DotWindow::kLanes * DotWindow::kLanes));
  for (int y = -radius_px_; y <= radius_px_ && radius_px_ > 0; ++y) {
    for (int x = -radius_px_; x <= radius_px_; ++x) {
      if (x * x + y * y > radius_px_ * (radius_px_ + 1)) continue;
      pixels_.push_back({x, y, static_cast<size_t>((y + radius_px_) * side + x + radius_px_)});
      keep_[pixels_.back().at] = -1;
    }
  }
  const size_t n = pixels_.size();
  templates_.resize(static_cast<size_t>(board.markers.lattice.count()));
  for (auto& h : h_) h.resize(templates_.size() * keep_.size());
  t_.resize(templates_.size() * keep_.size());
  for (Values& values : nuisance_) values.resize(n);
  free_.resize(n);
  for (Values& values : gradient_) values.resize(n);
  window_.resize(keep_.size() + static_cast<size_t>(side) + 1);
  sample_.resize(n);
}

void DotTemplates::learn(std::span<const uint16_t> rest, std::span<const Marker> markers) {
  for (size_t i = 0; i < templates_.size(); ++i) {
    templates_[i] = Template{};
    if (!markers[i].is_absent && !pixels_.empty()) learn_one(rest, markers[i], i);
  }
}

void DotTemplates::learn_one(std::span<const uint16_t> rest, const Marker& marker, size_t number) {
  Template& one = templates_[number];
  const size_t n = pixels_.size();
  one.x = (marker.rest_x.raw() + 32'768) >> 16;
  one.y = (marker.rest_y.raw() + 32'768) >> 16;
  const int reach = radius_px_ + 1;
  if (one.x < reach || one.y < reach || one.x >= width_px_ - reach || one.y >= height_px_ - reach) return;
  const auto level = [&](int x, int y) {
    const uint16_t* at = &rest[3 * (static_cast<size_t>(y) * static_cast<size_t>(width_px_) + static_cast<size_t>(x))];
    return std::min<int64_t>(round_shift(luma(at[0], at[1], at[2]), 10), 16 * 255);
  };
  int16_t* t = t_.data() + first(number);
  int64_t sum = 0;
  for (size_t i = 0; i < n; ++i) {
    const int x = one.x + pixels_[i].x;
    const int y = one.y + pixels_[i].y;
    sample_[i] = level(x, y);
    sum += sample_[i];
    const int64_t gx = gradient_[0][i] = (level(x + 1, y) - level(x - 1, y)) >> 1;
    const int64_t gy = gradient_[1][i] = (level(x, y + 1) - level(x, y - 1)) >> 1;
    const int64_t away_x_q8 = ((int64_t{x} << 16) - marker.rest_x.raw()) >> 8;
    const int64_t away_y_q8 = ((int64_t{y} << 16) - marker.rest_y.raw()) >> 8;
    nuisance_[0][i] = 256;
    nuisance_[2][i] = round_shift(away_x_q8 * gx, 8);
    nuisance_[3][i] = round_shift(away_y_q8 * gx, 8);
    nuisance_[4][i] = round_shift(away_x_q8 * gy, 8);
    nuisance_[5][i] = round_shift(away_y_q8 * gy, 8);
  }
  const int64_t mean = div_round(sum, std::max<int64_t>(std::ssize(pixels_), 1));
  for (size_t i = 0; i < n; ++i) {
    const int64_t above = nuisance_[1][i] = sample_[i] - mean;
    t[pixels_[i].at] = static_cast<int16_t>(above);
    one.tt += above * above;
    one.t_sum += above;
  }
  remove_nuisances(number);
  invert(one, gradient_[0], gradient_[1], number);
  for (size_t i = 0; i < n; ++i) {
    one.s0_x += h_[0][first(number) + pixels_[i].at] * sample_[i];
    one.s0_y += h_[1][first(number) + pixels_[i].at] * sample_[i];
  }
}

// Computes h of both axes.
void DotTemplates::remove_nuisances(size_t number) {
  for (size_t k = 1; k < nuisance_.size(); ++k) {
    for (size_t j = 0; j < k; ++j) free_of(nuisance_[j], nuisance_[k]);
  }
  for (size_t axis = 0; axis < 2; ++axis) {
    free_ = gradient_[axis];
    for (const Values& one : nuisance_) free_of(one, free_);
    for (size_t i = 0; i < free_.size(); ++i) {
      h_[axis][first(number) + pixels_[i].at] = static_cast<int16_t>(std::clamp(free_[i], -kMaxGradient, kMaxGradient));
    }
  }
}

// Computes K with its own scale, so that the larger of determinant and entry keeps 30 bits.
void DotTemplates::invert(Template& one, const Values& gx, const Values& gy, size_t number) const {
  const size_t n = pixels_.size();
  int64_t xx = 0, xy = 0, yx = 0, yy = 0;
  for (size_t i = 0; i < n; ++i) {
    const int64_t hx = h_[0][first(number) + pixels_[i].at];
    const int64_t hy = h_[1][first(number) + pixels_[i].at];
    xx += hx * gx[i];
    xy += hx * gy[i];
    yx += hy * gx[i];
    yy += hy * gy[i];
  }
  const int64_t det = xx * yy - xy * yx;
  if (xx <= 0 || yy <= 0 || det <= 0 || det / (xx + yy) < kMinContrast * static_cast<int64_t>(n)) return;
  const int b = std::max(static_cast<int>(std::bit_width(static_cast<uint64_t>(det))) - 33, 0);
  const std::array<int64_t, 4> entry = {yy, -xy, -yx, xx};
  for (size_t i = 0; i < 4; ++i) one.k[i] = floor_div(entry[i] * (int64_t{1} << 33), det >> b);
  const bool fits =
      std::none_of(one.k.begin(), one.k.end(), [](int64_t v) { return v >= kMaxInverse || v <= -kMaxInverse; });
  if (fits) one.shift = 33 + b - 16;
}

void DotTemplates::refine(const FrameView& frame, std::span<Marker> markers, std::span<int64_t> error2_q16) {
  for (size_t i = 0; i < markers.size(); ++i) {
    error2_q16[i] = kCentreError2;
    if (!markers[i].is_lost && templates_[i].shift != 0) refine_one(frame, i, markers[i], error2_q16[i]);
  }
}

void DotTemplates::refine_one(const FrameView& frame, size_t number, Marker& marker, int64_t& error2_q16) {
  const Template& one = templates_[number];
  const auto count = static_cast<int64_t>(pixels_.size());
  const int64_t x_q16 = (int64_t{one.x - radius_px_} << 16) + marker.displacement_x.raw();
  const int64_t y_q16 = (int64_t{one.y - radius_px_} << 16) + marker.displacement_y.raw();
  const int side = 2 * radius_px_ + 2;
  const auto x = static_cast<int>(x_q16 >> 16);
  const auto y = static_cast<int>(y_q16 >> 16);
  if (x < 0 || y < 0 || x + side > width_px_ || y + side > height_px_) return;
  const DotSums sums = run_({.pixels = frame.row(y) + ptrdiff_t{3} * x,
                             .stride = frame.stride,
                             .side = side,
                             .share_x = static_cast<int16_t>((x_q16 & 0xFFFF) >> 1),
                             .share_y = static_cast<int16_t>((y_q16 & 0xFFFF) >> 1),
                             .n_values = static_cast<int>(keep_.size()),
                             .h_x = h_[0].data() + first(number),
                             .h_y = h_[1].data() + first(number),
                             .t = t_.data() + first(number),
                             .keep = keep_.data(),
                             .luma = window_.data()});
  const int64_t ds_x = sums.h_x - one.s0_x;
  const int64_t ds_y = sums.h_y - one.s0_y;
  const auto step = [&](size_t k) {
    return std::clamp(round_shift(one.k[k] * ds_x + one.k[k + 1] * ds_y, one.shift), -kMaxStep, kMaxStep);
  };
  const int64_t step_x = step(0);
  const int64_t step_y = step(2);
  // At most 2^18 per pixel each; dropping a quarter of a squared grey level per pixel keeps all products below 2^63.
  const int64_t spread = (sums.square - sums.sum * sums.sum / count) >> 10;
  const int64_t common = (sums.common - floor_div(sums.sum * one.t_sum, count)) >> 10;
  const int64_t tt = one.tt >> 10;
  if (common <= 0 || tt <= 0 || 4 * common * common < tt * spread) {
    error2_q16 = kUnknown;
    return;
  }
  const int64_t unexplained = std::max<int64_t>(spread - common * common / tt, 0);
  const int64_t gain = std::max<int64_t>(one.k[0] + one.k[3], 0);
  error2_q16 = kMinError2 + (((gain * unexplained >> (one.shift - 16)) / count) >> 6) +
               ((step_x * step_x + step_y * step_y) >> 18);
  marker.displacement_x = ImagePx::from_raw(static_cast<int32_t>(marker.displacement_x.raw() - (3 * step_x >> 2)));
  marker.displacement_y = ImagePx::from_raw(static_cast<int32_t>(marker.displacement_y.raw() - (3 * step_y >> 2)));
}

}  // namespace ruffini
