#include "image/dots.h"

#include <algorithm>

#include "image/kernels.h"

namespace ruffini {
DotDetector::DotDetector(const DotParameters& parameters, const DotKernels& version)
    : p_(parameters),
      run_(version),
      tiles_(p_, version.tiles),
      no_row_(static_cast<size_t>(p_.width_px)),
      inverse_q32_(static_cast<size_t>(p_.width_px)),
      column_sum_(static_cast<size_t>(p_.width_px)),
      prefix_sum_(static_cast<size_t>(p_.width_px + 2 * p_.box_radius_px + 1)),
      blobs_(p_.width_px, p_.height_px),
      weight_(blobs_.row()) {
  dots_.reserve(kMaxDots);
}

DotDetector::DotDetector(const DotParameters& parameters)
    : DotDetector(parameters, kernels::fastest_supported().dots) {}

// Sums for the boxes of the row above row y.
void DotDetector::start(std::span<const uint16_t> grey, int y) {
  std::fill(column_sum_.begin(), column_sum_.end(), 0);
  const int r = p_.box_radius_px;
  tiles_.add_rows(grey, std::max(y - 1 - r, 0), std::min(y + r, p_.height_px), column_sum_.data());
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
    if (x == r && x < p_.width_px - r) x = p_.width_px - r;  // the boxes in between are not clipped
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
  run_.weigh({.width = p_.width_px,
              .box_radius_px = r,
              .is_light = p_.polarity == Polarity::kLight,
              .threshold_q15 = p_.threshold_1e3 * 32'768 / 1'000,
              .entering = row(y + r),
              .leaving = row(y - r - 1),
              .grey = row(y),
              .open = tiles_.open_tiles(y / DotTiles::kSide),
              .inverse_q32 = inverse_q32_.data(),
              .column_sum = column_sum_.data(),
              .prefix_sum = prefix_sum_.data(),
              .weight = weight_.data()});
}

std::span<const Dot> DotDetector::detect(std::span<const uint16_t> grey) {
  dots_.clear();
  blobs_.start();
  n_box_rows_ = 0;
  tiles_.measure(grey);
  for (int row = 0; row < tiles_.n_rows(); ++row) {
    const int first = row * DotTiles::kSide;
    if (!tiles_.has_open_tile(row)) {
      blobs_.pass_over();
      continue;
    }
    if (row == 0 || !tiles_.has_open_tile(row - 1)) start(grey, first);
    for (int y = first; y < std::min(first + DotTiles::kSide, p_.height_px); ++y) {
      weigh_row(grey, y);
      blobs_.add(weight_, y);
    }
  }
  for (size_t i = 0; i < blobs_.all().size() && dots_.size() < kMaxDots; ++i) {
    const Blob& c = blobs_.all()[i];
    if (c.parent != static_cast<int>(i) || c.touches_border || c.area < p_.min_area_px || c.area > p_.max_area_px)
      continue;
    dots_.push_back({ImagePx::from_raw(static_cast<int32_t>((c.weight_x << 16) / c.weight)),
                     ImagePx::from_raw(static_cast<int32_t>((c.weight_y << 16) / c.weight)), c.area});
  }
  return dots_;
}

}  // namespace ruffini
