#include "image/frame_watch.h"

#include <algorithm>
#include <array>
#include <cstdlib>

namespace ruffini {
namespace {

constexpr int kNearestPx = 12;
constexpr int kJitterPx = 9;
constexpr int kBandRows = 16;
constexpr int kValues = 6;          // values of a sample
constexpr int64_t kJumpLevels = 8;  // threshold per value
constexpr int kColumnRows = 40;     // approximate number of rows, without a period
constexpr size_t kMaxColumnRows = UINT16_MAX / 255;
constexpr int kLampRows = 8;  // each eighth row is used for the lamp check
// Mean of |difference| of two pixels, B + G + R, with noise of 12 grey levels each.
constexpr int64_t kNoiseOfSample = 24;
constexpr int64_t kMinLampLevel = 16;  // of rest: below it, a lamp cannot be distinguished from no lamp

}  // namespace

FrameWatch::FrameWatch(int width_px, int height_px)
    : width_px_(width_px),
      column_sum_(size_t{3} * static_cast<size_t>(width_px)),
      column_rest_(static_cast<size_t>(width_px)),
      rest_(static_cast<size_t>(height_px)),
      now_(static_cast<size_t>(height_px)) {
  uint32_t lot = 1;
  const auto draw = [&](int n) {
    const int drawn = static_cast<int>(lot >> 16) % n;
    lot = lot * 1'103'515'245 + 12'345;
    return drawn;
  };
  for (int x = 2; x + 1 < width_px; x += kNearestPx + draw(kJitterPx)) at_.push_back(x);
  const int step = std::max(height_px / kColumnRows, 2);
  for (int y = 1; y < height_px && rows_.size() < kMaxColumnRows; y += 1 + draw(2 * step - 1)) rows_.push_back(y);
}

void FrameWatch::learn(std::span<const uint16_t> rest) {
  rest_channel_.fill(0);
  max_rough_ = 0;
  int64_t band = 0;
  for (size_t y = 0; y < rest_.size(); ++y) {
    int32_t level = 0;
    int32_t rough = 0;
    for (const int32_t x : at_) {
      const uint16_t* sample = &rest[3 * (y * static_cast<size_t>(width_px_) + static_cast<size_t>(x))];
      const int32_t left = sample[0] + sample[1] + sample[2];
      const int32_t right = sample[3] + sample[4] + sample[5];
      level += left + right;
      rough += std::abs(left - right);
      for (size_t c = 0; c < 3 && y % size_t{kLampRows} == 0; ++c) rest_channel_[c] += sample[c];
    }
    rest_[y] = {level / 16, rough / 16};
    band += rest_[y].rough - (y < kBandRows ? 0 : rest_[y - kBandRows].rough);
    max_rough_ = std::max(max_rough_, band);
  }
  for (int64_t& sum : rest_channel_) sum /= 16;
  std::fill(column_rest_.begin(), column_rest_.end(), 0);
  for (const int y : rows_) {
    for (size_t x = 0; x < column_rest_.size(); ++x) {
      const uint16_t* pixel = &rest[3 * (static_cast<size_t>(y) * column_rest_.size() + x)];
      column_rest_[x] += pixel[0] + pixel[1] + pixel[2];
    }
  }
  for (int32_t& sum : column_rest_) sum /= 16;
}

FrameWatch::Defects FrameWatch::run(const FrameView& frame) {
  std::array<int64_t, 3> channel{};
  for (int y = 0; y < frame.height; ++y) {
    const uint8_t* pixels = frame.row(y);
    Row row;
    for (const int32_t x : at_) {
      const uint8_t* sample = pixels + ptrdiff_t{3} * x;
      const int32_t left = sample[0] + sample[1] + sample[2];
      const int32_t right = sample[3] + sample[4] + sample[5];
      row.level += left + right;
      row.rough += std::abs(left - right);
    }
    now_[static_cast<size_t>(y)] = row;
    for (size_t i = 0; i < at_.size() && y % kLampRows == 0; ++i) {
      for (ptrdiff_t c = 0; c < 3; ++c) channel[static_cast<size_t>(c)] += pixels[ptrdiff_t{3} * at_[i] + c];
    }
  }
  add_columns(frame);
  const int64_t n_pixels = std::ssize(at_) * ((frame.height + kLampRows - 1) / kLampRows);
  Defects defects{.is_broken = is_broken() || has_broken_column()};
  int64_t all = 0;
  int64_t rest_all = 0;
  for (size_t c = 0; c < 3; ++c) {
    const bool has_lamp = rest_channel_[c] > kMinLampLevel * n_pixels;
    const bool is_off = 2 * channel[c] < rest_channel_[c] || channel[c] > 2 * rest_channel_[c];
    defects.is_light_wrong = defects.is_light_wrong || (has_lamp && is_off);
    all += channel[c];
    rest_all += rest_channel_[c];
  }
  defects.is_level_off = 4 * std::abs(all - rest_all) > rest_all;
  return defects;
}

void FrameWatch::add_columns(const FrameView& frame) {
  std::fill(column_sum_.begin(), column_sum_.end(), uint16_t{0});
  for (const int y : rows_) {
    const uint8_t* pixels = frame.row(y);
    for (size_t i = 0; i < column_sum_.size(); ++i) {
      column_sum_[i] = static_cast<uint16_t>(column_sum_[i] + pixels[i]);
    }
  }
}

bool FrameWatch::has_broken_column() const {
  const int64_t n = 3 * std::ssize(rows_);
  int64_t before = 0;
  for (size_t x = 0; x < column_rest_.size(); ++x) {
    const int64_t now = int64_t{column_sum_[3 * x]} + column_sum_[3 * x + 1] + column_sum_[3 * x + 2];
    const int64_t change = now - column_rest_[x];
    const int64_t usual = x == 0 ? 0 : (column_rest_[x] + column_rest_[x - 1]) / 2;
    if (x > 0 && std::abs(change - before) > usual / 2 + kJumpLevels * n) return true;
    before = change;
  }
  return false;
}

bool FrameWatch::is_broken() const {
  const int64_t n = std::ssize(at_);
  int64_t band = 0;
  for (size_t y = 0; y < now_.size(); ++y) {
    band += now_[y].rough - (y < kBandRows ? 0 : now_[y - kBandRows].rough);
    if (band > 2 * max_rough_ + kNoiseOfSample * kBandRows * n) return true;
    if (y == 0) continue;
    const int64_t jump = (now_[y].level - rest_[y].level) - (now_[y - 1].level - rest_[y - 1].level);
    const int64_t usual = (rest_[y].level + rest_[y - 1].level) / 2;
    if (std::abs(jump) > usual / 4 + kJumpLevels * kValues * n) return true;
  }
  return false;
}

}  // namespace ruffini
