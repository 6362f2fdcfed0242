#include "image/dots.h"

#include <algorithm>

namespace ruffini {

DotDetector::DotDetector(const DotParameters& parameters)
    : p_(parameters),
      column_sum_(static_cast<size_t>(p_.width_px)),
      prefix_sum_(static_cast<size_t>(p_.width_px) + 1),
      weight_(static_cast<size_t>(p_.width_px)),
      label_(static_cast<size_t>(p_.width_px)),
      components_(static_cast<size_t>(p_.width_px) * static_cast<size_t>(p_.height_px) / 2 + 1) {
  dots_.reserve(kMaxDots);
}

// Column sums over the rows [y - r, y + r] that exist.
void DotDetector::move_box(std::span<const uint16_t> grey, int y) {
  const auto width = static_cast<size_t>(p_.width_px);
  const auto row = [&](int v) { return grey.subspan(static_cast<size_t>(v) * width, width); };
  const int r = p_.box_radius_px;
  if (y == 0) {
    std::fill(column_sum_.begin(), column_sum_.end(), 0);
    for (int v = 0; v < std::min(r, p_.height_px); ++v) {
      for (size_t x = 0; x < width; ++x) column_sum_[x] += row(v)[x];
    }
  }
  if (y + r < p_.height_px) {
    for (size_t x = 0; x < width; ++x) column_sum_[x] += row(y + r)[x];
  }
  if (y - r - 1 >= 0) {
    for (size_t x = 0; x < width; ++x) column_sum_[x] -= row(y - r - 1)[x];
  }
  for (size_t x = 0; x < width; ++x) prefix_sum_[x + 1] = prefix_sum_[x] + column_sum_[x];
}

void DotDetector::weigh_row(std::span<const uint16_t> grey, int y) {
  move_box(grey, y);
  const int r = p_.box_radius_px;
  const int rows = std::min(y + r, p_.height_px - 1) - std::max(y - r, 0) + 1;
  const uint16_t* pixels = grey.data() + static_cast<size_t>(y) * static_cast<size_t>(p_.width_px);
  for (int x = 0; x < p_.width_px; ++x) {
    const int left = std::max(x - r, 0);
    const int right = std::min(x + r, p_.width_px - 1);
    const int64_t sum = prefix_sum_[static_cast<size_t>(right) + 1] - prefix_sum_[static_cast<size_t>(left)];
    const auto background = static_cast<int32_t>(sum / (int64_t{rows} * (right - left + 1)));
    const int32_t v = p_.polarity == Polarity::kDark ? background - pixels[x] : pixels[x] - background;
    weight_[static_cast<size_t>(x)] = std::max(v - background * p_.threshold_1e3 / 1000, 0);
  }
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

std::span<const Dot> DotDetector::detect(std::span<const uint16_t> grey) {
  n_components_ = 0;
  dots_.clear();
  std::fill(label_.begin(), label_.end(), -1);
  for (int y = 0; y < p_.height_px; ++y) {
    weigh_row(grey, y);
    int left = -1;
    for (int x = 0; x < p_.width_px; ++x) {
      int& label = label_[static_cast<size_t>(x)];
      const int above = label;
      const int32_t weight = weight_[static_cast<size_t>(x)];
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
  for (int i = 0; i < n_components_ && dots_.size() < kMaxDots; ++i) {
    const Component& c = components_[static_cast<size_t>(i)];
    if (c.parent != i || c.touches_border || c.area < p_.min_area_px || c.area > p_.max_area_px) continue;
    dots_.push_back({ImagePx::from_raw(static_cast<int32_t>((c.weight_x << 16) / c.weight)),
                     ImagePx::from_raw(static_cast<int32_t>((c.weight_y << 16) / c.weight)), c.area});
  }
  return dots_;
}

}  // namespace ruffini
