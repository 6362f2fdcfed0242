#include "image/disc_edge.h"

#include <algorithm>
#include <bit>

#include "base/fixed.h"
#include "image/trigonometry.h"

namespace ruffini {
namespace {

constexpr int kEnd = 3;             // pixels of a ray's dark and bright ends
constexpr int64_t kStepQ12 = 2048;  // half a pixel
constexpr int kTaps = 2;            // of the filter, to each side
// Of the patch: reach of the first pass's rays, plus the same for the correction of the centre
constexpr int kMargin = 28;
constexpr int64_t kPiQ10 = 3'217;

template <typename T>
uint16_t filtered(const T* at, ptrdiff_t step) {
  const int32_t sum = at[-2 * step] + at[2 * step] + 4 * (at[-step] + at[step]) + 6 * at[0];
  return static_cast<uint16_t>((sum + 8) >> 4);
}

}  // namespace

DiscEdge::DiscEdge(int width_px, int height_px, int radius_px)
    : width_px_(width_px), height_px_(height_px), side_px_(2 * (radius_px + kMargin) + 1) {
  const auto side = static_cast<size_t>(side_px_);
  row_.resize(side + 2 * kTaps);
  along_.resize(side * (side + 2 * kTaps));
  patch_.resize(side * side);
  for (size_t k = 0; k < kRays; ++k) {
    const auto angle = static_cast<int64_t>(2 * k);
    direction_q14_[k] = {static_cast<int32_t>(round_shift(cos_pi_q30(angle, kRays), 16)),
                         static_cast<int32_t>(round_shift(cos_pi_q30(angle - int64_t{kRays} / 2, kRays), 16))};
  }
}

// Smooths the patch around a pixel.
void DiscEdge::smooth(std::span<const uint16_t> grey, int middle_x, int middle_y) {
  left_px_ = middle_x - side_px_ / 2;
  top_px_ = middle_y - side_px_ / 2;
  const auto side = static_cast<size_t>(side_px_);
  for (size_t v = 0; v < side + 2 * kTaps; ++v) {
    const int y = std::clamp(top_px_ + static_cast<int>(v) - kTaps, 0, height_px_ - 1);
    const uint16_t* picture = grey.data() + ptrdiff_t{y} * width_px_;
    const int first = left_px_ - kTaps;
    const uint16_t* from = picture + first;
    if (first < 0 || first + std::ssize(row_) > width_px_) {
      for (size_t u = 0; u < row_.size(); ++u)
        row_[u] = picture[std::clamp(first + static_cast<int>(u), 0, width_px_ - 1)];
      from = row_.data();
    }
    uint16_t* out = &along_[v * side];
    for (size_t u = 0; u < side; ++u) out[u] = filtered(from + u + kTaps, 1);
  }
  for (size_t v = 0; v < side; ++v) {
    const uint16_t* from = &along_[(v + kTaps) * side];
    uint16_t* out = &patch_[v * side];
    for (size_t u = 0; u < side; ++u) out[u] = filtered(from + u, static_cast<ptrdiff_t>(side));
  }
}

// True if the four pixels around a position on a ray are in the picture and in the patch.
bool DiscEdge::is_inside(const DiscMeasurement& from, size_t ray, int64_t r_q12) const {
  const int64_t x = (from.x_q16 + (r_q12 * direction_q14_[ray][0] >> 10)) >> 16;
  const int64_t y = (from.y_q16 + (r_q12 * direction_q14_[ray][1] >> 10)) >> 16;
  const auto is_in = [](int64_t at, int64_t first, int64_t n) { return at >= first && at < first + n - 1; };
  return is_in(x, 0, width_px_) && is_in(y, 0, height_px_) && is_in(x, left_px_, side_px_) &&
         is_in(y, top_px_, side_px_);
}

// Bilinear grey, Q8.
int64_t DiscEdge::sample(const DiscMeasurement& from, size_t ray, int64_t r_q12) const {
  const int64_t x = from.x_q16 + (r_q12 * direction_q14_[ray][0] >> 10) - (int64_t{left_px_} << 16);
  const int64_t y = from.y_q16 + (r_q12 * direction_q14_[ray][1] >> 10) - (int64_t{top_px_} << 16);
  const auto fx = static_cast<int32_t>(x >> 8 & 255);
  const auto fy = static_cast<int32_t>(y >> 8 & 255);
  const uint16_t* at = &patch_[static_cast<size_t>((y >> 16) * side_px_ + (x >> 16))];
  const int32_t upper = at[0] * (256 - fx) + at[1] * fx;
  const int32_t lower = at[side_px_] * (256 - fx) + at[side_px_ + 1] * fx;
  return (upper * (256 - fy) + int64_t{lower} * fy) >> 8;
}

DiscEdge::Edge DiscEdge::edge(const DiscMeasurement& from, const Turn& turn, size_t ray) const {
  const auto px = [](int64_t n) { return n << 12; };
  const int64_t outer = from.radius_q12 + px(turn.far_px);
  const int64_t inner = from.radius_q12 - px(turn.far_px);
  if (!is_inside(from, ray, outer)) return {};
  int64_t dark = 0;
  int64_t bright = 0;
  for (int i = 0; i < kEnd; ++i) {
    dark += sample(from, ray, inner + px(i));
    bright += sample(from, ray, outer - px(i));
  }
  if (2 * dark >= bright) return {};
  const int64_t level = (dark + bright + kEnd) / (2 * kEnd);
  int64_t r = from.radius_q12 - px(turn.near_px);
  int64_t before = sample(from, ray, r);
  if (before > level) return {};
  for (int i = 0; i < 4 * turn.near_px; ++i) {
    r += kStepQ12;
    const int64_t now = sample(from, ray, r);
    if (now > level) return {r - kStepQ12 + (level - before) * kStepQ12 / (now - before), bright};
    before = now;
  }
  return {};
}

DiscMeasurement DiscEdge::measure(const DiscMeasurement& from, const Turn& turn) const {
  const size_t n = kRays / turn.every;
  std::array<int64_t, kRays> r;
  int64_t n_seen = 0;
  int64_t sum = 0;
  int64_t bright = 0;
  for (size_t i = 0; i < n; ++i) {
    const Edge found = edge(from, turn, i * turn.every);
    r[i] = found.r_q12;
    if (found.r_q12 < 0) continue;
    ++n_seen;
    sum += found.r_q12;
    bright += found.bright;
  }
  DiscMeasurement out = from;
  out.is_seen = 4 * n_seen >= 3 * static_cast<int64_t>(n);
  if (!out.is_seen) return out;
  out.radius_q12 = floor_div(2 * sum + n_seen, 2 * n_seen);
  out.bright_q8 = bright / (kEnd * n_seen);
  int64_t along_x = 0;
  int64_t along_y = 0;
  int64_t squares = 0;
  for (size_t i = 0; i < n; ++i) {
    const int64_t each = r[i] < 0 ? out.radius_q12 : r[i];
    along_x += each * direction_q14_[i * turn.every][0];
    along_y += each * direction_q14_[i * turn.every][1];
    squares += each * each;
  }
  const int log_n = std::countr_zero(n);
  out.x_q16 += round_shift(along_x, 9 + log_n);
  out.y_q16 += round_shift(along_y, 9 + log_n);
  out.area_q8 = round_shift(squares * kPiQ10, 26 + log_n);
  return out;
}

DiscMeasurement DiscEdge::locate(std::span<const uint16_t> grey, const DiscMeasurement& about) {
  constexpr Turn kFind = {.every = 4, .far_px = 12, .near_px = 9};
  constexpr Turn kMeasure = {.every = 1, .far_px = 8, .near_px = 5};
  smooth(grey, static_cast<int>(round_shift(about.x_q16, 16)), static_cast<int>(round_shift(about.y_q16, 16)));
  const DiscMeasurement found = measure(about, kFind);
  return found.is_seen ? measure(found, kMeasure) : found;
}

}  // namespace ruffini
