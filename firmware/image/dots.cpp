#include "image/dots.h"

#include <algorithm>
#include <cstring>

#include "image/kernels.h"

namespace ruffini {
namespace {

constexpr int kZeroRun = 4;  // weights that are looked at together
static_assert(kZeroRun * sizeof(int16_t) == sizeof(uint64_t));

}  // namespace

DotDetector::DotDetector(const DotParameters& parameters, DotRun version)
    : p_(parameters),
      run_(version),
      no_row_(static_cast<size_t>(p_.width_px)),
      inverse_q32_(static_cast<size_t>(p_.width_px)),
      column_sum_(static_cast<size_t>(p_.width_px)),
      prefix_sum_(static_cast<size_t>(p_.width_px + 2 * p_.box_radius_px + 1)),
      weight_((static_cast<size_t>(p_.width_px) + kZeroRun - 1) / kZeroRun * kZeroRun),
      label_(weight_.size()),
      components_(static_cast<size_t>(p_.width_px) * static_cast<size_t>(p_.height_px) / 2 + 1) {
  dots_.reserve(kMaxDots);
}

DotDetector::DotDetector(const DotParameters& parameters) : DotDetector(parameters, kernels::best().dots) {}

// The boxes of the row above the first one.
void DotDetector::start(std::span<const uint16_t> grey) {
  const auto width = static_cast<size_t>(p_.width_px);
  std::fill(column_sum_.begin(), column_sum_.end(), 0);
  for (int y = 0; y < std::min(p_.box_radius_px, p_.height_px); ++y) {
    const auto row = grey.subspan(static_cast<size_t>(y) * width, width);
    for (size_t x = 0; x < width; ++x) column_sum_[x] += row[x];
  }
  n_box_rows_ = 0;
}

void DotDetector::invert_areas(int n_rows) {
  if (n_rows == n_box_rows_) return;
  n_box_rows_ = n_rows;
  const int r = p_.box_radius_px;
  const auto inverse = [&](int n_columns) {
    const int64_t area = int64_t{n_rows} * n_columns;
    return static_cast<int32_t>(((int64_t{1} << 33) + area) / (2 * area));
  };
  std::fill(inverse_q32_.begin(), inverse_q32_.end(), inverse(std::min(2 * r + 1, p_.width_px)));
  for (int x = 0; x < p_.width_px; ++x) {
    if (x == r && x < p_.width_px - r) x = p_.width_px - r;  // the boxes between are whole
    if (x < p_.width_px)
      inverse_q32_[static_cast<size_t>(x)] = inverse(std::min(x + r, p_.width_px - 1) - std::max(x - r, 0) + 1);
  }
}

void DotDetector::weigh_row(std::span<const uint16_t> grey, int y) {
  const int r = p_.box_radius_px;
  invert_areas(std::min(y + r, p_.height_px - 1) - std::max(y - r, 0) + 1);
  const auto row = [&](int v) {
    return v < 0 || v >= p_.height_px ? no_row_.data() : grey.data() + ptrdiff_t{v} * p_.width_px;
  };
  run_({.width = p_.width_px,
        .box_radius_px = r,
        .is_light = p_.polarity == Polarity::kLight,
        .threshold_q15 = p_.threshold_1e3 * 32'768 / 1'000,
        .entering = row(y + r),
        .leaving = row(y - r - 1),
        .grey = row(y),
        .inverse_q32 = inverse_q32_.data(),
        .column_sum = column_sum_.data(),
        .prefix_sum = prefix_sum_.data(),
        .weight = weight_.data()});
}

int DotDetector::find(int component) {
  while (components_[static_cast<size_t>(component)].parent != component) {
    component = components_[static_cast<size_t>(component)].parent;
  }
  return component;
}

// The smaller index stays, so that a component keeps the place of its first pixel.
int DotDetector::join(int a, int b) {
  a = find(a);
  b = find(b);
  if (a == b) return a;
  if (b < a) std::swap(a, b);
  Component& kept = components_[static_cast<size_t>(a)];
  Component& merged = components_[static_cast<size_t>(b)];
  merged.parent = a;
  kept.area += merged.area;
  kept.touches_border = kept.touches_border || merged.touches_border;
  kept.weight += merged.weight;
  kept.weight_x += merged.weight_x;
  kept.weight_y += merged.weight_y;
  return a;
}

void DotDetector::label_row(int y) {
  int left = -1;
  for (int x = 0; x < p_.width_px; ++x) {
    const auto at = static_cast<size_t>(x);
    if (x % kZeroRun == 0) {  // most of a picture is not dots
      uint64_t several;
      std::memcpy(&several, &weight_[at], sizeof several);
      if (several == 0) {
        std::fill_n(&label_[at], kZeroRun, -1);
        left = -1;
        x += kZeroRun - 1;
        continue;
      }
    }
    int& label = label_[at];
    const int above = label;
    const int32_t weight = weight_[at];
    if (weight == 0) {
      label = left = -1;
      continue;
    }
    if (left >= 0 && above >= 0) {
      label = join(left, above);
    } else if (left >= 0 || above >= 0) {
      label = find(std::max(left, above));
    } else {
      label = n_components_++;
      components_[static_cast<size_t>(label)] = Component{.parent = label};
    }
    left = label;
    Component& component = components_[static_cast<size_t>(label)];
    ++component.area;
    component.touches_border =
        component.touches_border || x == 0 || y == 0 || x == p_.width_px - 1 || y == p_.height_px - 1;
    component.weight += weight;
    component.weight_x += int64_t{weight} * x;
    component.weight_y += int64_t{weight} * y;
  }
}

std::span<const Dot> DotDetector::detect(std::span<const uint16_t> grey) {
  n_components_ = 0;
  dots_.clear();
  std::fill(label_.begin(), label_.end(), -1);
  start(grey);
  for (int y = 0; y < p_.height_px; ++y) {
    weigh_row(grey, y);
    label_row(y);
  }
  for (int i = 0; i < n_components_ && dots_.size() < kMaxDots; ++i) {
    const Component& c = components_[static_cast<size_t>(i)];
    if (c.parent != i || c.touches_border || c.area < p_.min_area_px || c.area > p_.max_area_px) continue;
    dots_.push_back({ImagePx::from_raw(static_cast<int32_t>((c.weight_x << 16) / c.weight)),
                     ImagePx::from_raw(static_cast<int32_t>((c.weight_y << 16) / c.weight)), c.area});
  }
  return dots_;
}

}  // namespace ruffini
