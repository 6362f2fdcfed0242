#include "image/dot_tiles.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr int32_t kNothing = INT16_MIN;  // below every grey and every -grey

size_t as_size(int n) { return static_cast<size_t>(n); }

}  // namespace

DotTiles::DotTiles(const DotParameters& parameters, const TileKernels& kernels)
    : p_(parameters),
      run_(kernels),
      n_x_((p_.width_px + kSide - 1) / kSide),
      n_y_((p_.height_px + kSide - 1) / kSide),
      inner_(p_.box_radius_px < kSide - 1 ? -1 : (p_.box_radius_px - kSide + 1) / kSide),
      outer_((p_.box_radius_px + kSide - 1) / kSide),
      max_grey_stride_(n_x_ + 2 * outer_),
      sum_stride_(n_x_ + 1 + 2 * std::max(inner_, 0)),
      area_(std::min(2 * p_.box_radius_px + 1, p_.width_px) * std::min(2 * p_.box_radius_px + 1, p_.height_px)),
      inverse_q32_(static_cast<int32_t>(((int64_t{1} << 33) + area_) / (2 * int64_t{area_}))),
      column_sum_(as_size(n_y_) * as_size(p_.width_px)),
      min_grey_(as_size(n_x_) * as_size(n_y_)),
      max_grey_(as_size(max_grey_stride_) * as_size(n_y_ + 2 * outer_), kNothing),
      sum_(as_size(sum_stride_) * as_size(n_y_ + 1)),
      row_sum_(as_size(n_x_)),
      n_columns_(as_size(n_x_)),
      open_(as_size(n_x_) * as_size(n_y_)),
      has_open_tile_(as_size(n_y_)) {
  for (int x = 0; x < n_x_ && inner_ >= 0; ++x) {
    n_columns_[as_size(x)] = std::min(kSide * (x + inner_ + 1), p_.width_px) - std::max(kSide * (x - inner_), 0);
  }
}

void DotTiles::measure(std::span<const uint16_t> grey) {
  std::fill(max_grey_.begin(), max_grey_.end(), kNothing);
  const int margin = std::max(inner_, 0);
  for (int row = 0; row < n_y_; ++row) {
    run_.measure({.width = p_.width_px,
                  .n_rows = std::min(kSide, p_.height_px - kSide * row),
                  .is_light = p_.polarity == Polarity::kLight,
                  .grey = grey.data() + at(kSide * row, p_.width_px),
                  .column_sum = column_sum_.data() + at(row, p_.width_px),
                  .min_grey = min_grey_.data() + at(row, n_x_),
                  .max_grey = max_grey_.data() + at(row + outer_, max_grey_stride_) + outer_,
                  .sum = row_sum_.data()});
    const int32_t* above = sum_.data() + at(row, sum_stride_) + margin;
    int32_t* out = sum_.data() + at(row + 1, sum_stride_) + margin;
    uint32_t so_far = 0;  // may wrap at 32 bits; differences stay exact
    for (int x = 0; x < n_x_; ++x) {
      so_far += static_cast<uint32_t>(row_sum_[as_size(x)]);
      out[x + 1] = static_cast<int32_t>(static_cast<uint32_t>(above[x + 1]) + so_far);
    }
    std::fill_n(out + n_x_ + 1, margin, out[n_x_]);
  }
  widen();
  for (int row = 0; row < n_y_; ++row) bound(row);
}

// Each tile's largest of the 2 outer_ + 1 squared ones around it: by doubling, first along rows, then along columns.
void DotTiles::widen() {
  const int n = 2 * outer_ + 1;
  const auto size = static_cast<int>(max_grey_.size());
  for (const int step : {1, max_grey_stride_}) {
    int done = 1;
    for (; 2 * done <= n; done *= 2) run_.widen(max_grey_.data(), size - done * step, done * step);
    if (done < n) run_.widen(max_grey_.data(), size - (n - done) * step, (n - done) * step);
  }
}

void DotTiles::bound(int row) {
  const int first = std::max(row - inner_, 0);
  const int end = inner_ < 0 ? first : std::min(row + inner_ + 1, n_y_);
  const int32_t* low = sum_.data() + at(first, sum_stride_);
  const int32_t* high = sum_.data() + at(end, sum_stride_);
  const int width = 2 * std::max(inner_, 0) + 1;
  run_.bound({.n_tiles = n_x_,
              .is_light = p_.polarity == Polarity::kLight,
              .threshold_q15 = p_.threshold_1e3 * 32'768 / 1'000,
              .area = area_,
              .inverse_q32 = inverse_q32_,
              .n_rows = std::min(kSide * end, p_.height_px) - kSide * first,
              .n_columns = n_columns_.data(),
              .high_right = high + width,
              .high_left = high,
              .low_right = low + width,
              .low_left = low,
              .min_grey = min_grey_.data() + at(row, n_x_),
              .max_grey_in_boxes = max_grey_.data() + at(row, max_grey_stride_),
              .open = open_.data() + at(row, n_x_)});
  const int16_t* out = open_tiles(row);
  has_open_tile_[as_size(row)] = std::any_of(out, out + n_x_, [](int16_t is_open) { return is_open != 0; }) ? 1 : 0;
}

void DotTiles::add_rows(std::span<const uint16_t> grey, int from, int to, int32_t* sums) const {
  for (int y = from; y < to;) {
    const int next = std::min(y + kSide, p_.height_px);
    if (y % kSide == 0 && next <= to) {
      run_.add(sums, column_sum_.data() + at(y / kSide, p_.width_px), p_.width_px);
      y = next;
    } else {
      run_.add_grey(sums, grey.data() + at(y, p_.width_px), p_.width_px);
      ++y;
    }
  }
}

}  // namespace ruffini
