#include "image/pixel_statistics.h"

#include <algorithm>
#include <cstdlib>

namespace ruffini {
namespace {

constexpr int kWindows = 240;
constexpr int kWide = 4;
constexpr int kHigh = 2;
// Grey levels that can be equal without a fault: at or below this, and from the other one on
constexpr uint32_t kBlack = 2;
constexpr uint32_t kWhite = 253;
constexpr uint16_t kUsableLow = 16 * 16;
constexpr uint16_t kUsableHigh = 16 * 240;
constexpr size_t kFewest = 24;
constexpr int32_t kOffQ12 = 33;   // 0.8 %
constexpr int64_t kAgainst = 20;  // maximum ratio of the medians' sum to their difference

}  // namespace

PixelStatistics::PixelStatistics(int width_px, int height_px) : width_px_(width_px) {
  if (width_px < kWide || height_px < kHigh) return;
  uint32_t lot = 1;
  const auto draw = [&](int n) {
    const int drawn = static_cast<int>(lot >> 16) % n;
    lot = lot * 1'103'515'245 + 12'345;
    return drawn;
  };
  for (int i = 0; i < kWindows; ++i) {
    const int x = draw(width_px - kWide + 1);
    windows_.push_back({x, draw(height_px - kHigh + 1)});
  }
  sum_.resize(windows_.size());
  sorted_.resize(windows_.size());
  for (std::vector<Level>& levels : levels_) levels.reserve(windows_.size());
}

void PixelStatistics::add_window(const FrameView& frame, size_t window, Ties& ties) {
  std::array<int32_t, 3> sum{};
  uint32_t n_equal = 0;
  uint32_t n = 0;
  for (int row = 0; row < kHigh; ++row) {
    const uint8_t* pixels = frame.row(windows_[window].y + row) + ptrdiff_t{3} * windows_[window].x;
    for (size_t c = 0; c < 3; ++c) sum[c] += pixels[c] + pixels[3 + c] + pixels[6 + c] + pixels[9 + c];
    for (size_t i = 3; i < size_t{3} * kWide; ++i) {  // branch-free
      const uint32_t counts = uint32_t{pixels[i]} - (kBlack + 1) < kWhite - kBlack - 1 ? 1U : 0U;
      n += counts;
      n_equal += counts & (pixels[i] == pixels[i - 3] ? 1U : 0U);
    }
  }
  sum_[window] = sum;
  ties.n_equal += n_equal;
  ties.n += n;
}

void PixelStatistics::add_rest(const FrameView& frame) {
  for (size_t i = 0; i < windows_.size(); ++i) add_window(frame, i, rest_ties_);
}

void PixelStatistics::learn(std::span<const uint16_t> rest) {
  has_levels_ = !windows_.empty();
  for (size_t c = 0; c < 3; ++c) {
    std::vector<Level>& levels = levels_[c];
    levels.clear();
    for (size_t w = 0; w < windows_.size(); ++w) {
      uint16_t least = UINT16_MAX;
      uint16_t most = 0;
      int32_t sum = 0;
      for (int k = 0; k < kWide * kHigh; ++k) {
        const int at = (windows_[w].y + k / kWide) * width_px_ + windows_[w].x + k % kWide;
        const uint16_t level = rest[size_t{3} * static_cast<size_t>(at) + c];
        least = std::min(least, level);
        most = std::max(most, level);
        sum += level;
      }
      if (least < kUsableLow || most > kUsableHigh || 4 * least < 3 * most) continue;
      levels.push_back({sum, (1 << 24) / sum, static_cast<int32_t>(w)});
    }
    std::sort(levels.begin(), levels.end(),
              [](const Level& a, const Level& b) { return a.rest != b.rest ? a.rest < b.rest : a.window < b.window; });
    const size_t third = levels.size() / 3;
    has_levels_ =
        has_levels_ && third >= kFewest && 5 * levels[levels.size() - 1 - third / 2].rest >= 6 * levels[third / 2].rest;
  }
}

int32_t PixelStatistics::median(std::span<const Level> levels, size_t channel) {
  const auto end = std::transform(levels.begin(), levels.end(), sorted_.begin(), [&](const Level& level) {
    const int32_t now = sum_[static_cast<size_t>(level.window)][channel];
    return ((16 * now - level.rest) * level.reciprocal_q24) >> 12;
  });
  const auto middle = sorted_.begin() + static_cast<ptrdiff_t>(levels.size() / 2);
  std::nth_element(sorted_.begin(), middle, end);
  return *middle;
}

bool PixelStatistics::is_off_curve(const Rest::Gain& gain) {
  int n_more = 0;
  int n_less = 0;
  int64_t both = 0;
  int64_t apart = 0;
  for (size_t c = 0; c < 3; ++c) {
    const std::span<const Level> levels = levels_[c];
    const int32_t dark = median(levels.first(levels.size() / 3), c);
    const int32_t bright = median(levels.last(levels.size() / 3), c);
    const int32_t off = dark + bright - ((gain[c] - Rest::kUnitGain) >> 7);  // twice the offset
    n_more += off > 2 * kOffQ12 ? 1 : 0;
    n_less += off < -2 * kOffQ12 ? 1 : 0;
    both += off;
    apart += bright - dark;
  }
  return (n_more == 3 && -kAgainst * apart > both) || (n_less == 3 && kAgainst * apart > -both);
}

PixelStatistics::Defects PixelStatistics::run(const FrameView& frame, const Rest::Gain& gain) {
  Ties now;
  for (size_t i = 0; i < windows_.size(); ++i) add_window(frame, i, now);
  // now > 1.2 rest + 0.01, as shares.
  const bool is_coarse = rest_ties_.n > 0 && now.n > 0 &&
                         100 * now.n_equal * rest_ties_.n > (120 * rest_ties_.n_equal + rest_ties_.n) * now.n;
  return {.is_coarse = is_coarse, .is_off_curve = has_levels_ && is_off_curve(gain)};
}

}  // namespace ruffini
