#include "image/pixel_statistics.h"

#include <algorithm>
#include <bit>
#include <cstdlib>
#include <cstring>

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
constexpr int64_t kMissingPercent = 70;
constexpr size_t kFewest = 24;
constexpr int32_t kOffQ12 = 33;   // 0.8 %
constexpr int64_t kAgainst = 20;  // maximum ratio of the medians' sum to their difference

// Eight bytes in one word; the masks below have the highest bit of each byte that is meant.
constexpr uint64_t kEach = 0x0101'0101'0101'0101;
constexpr uint64_t kHighest = 0x80 * kEach;

constexpr uint64_t kEven = 0x00ff'00ff'00ff;  // of six bytes
static_assert(std::endian::native == std::endian::little);

// Eight bytes, each in a lane of its own. GCC and clang have such types for every target.
using Bytes __attribute__((vector_size(16))) = uint8_t;
using Lanes __attribute__((vector_size(16))) = int16_t;
constexpr size_t kSumWindows = 32;  // whose colours a lane can hold: 32 kHigh 2 255 < 2^15

Lanes lanes(const uint8_t* bytes) {
  Bytes eight{};
  std::memcpy(&eight, bytes, 8);
  return reinterpret_cast<Lanes>(
      __builtin_shufflevector(eight, Bytes{}, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23));
}

uint64_t eight(const uint8_t* bytes) {
  uint64_t word = 0;
  std::memcpy(&word, bytes, sizeof(word));
  return word;
}

// Bytes below n, 0 < n <= 128.
uint64_t below(uint64_t word, uint64_t n) { return ~(((word & ~kHighest) + (0x80 - n) * kEach) | word) & kHighest; }

uint64_t zeros(uint64_t word) { return below(word, 1); }

// Marked bytes of a mask.
uint32_t count(uint64_t mask) { return static_cast<uint32_t>((mask >> 7) * kEach >> 56); }

// Bytes that are neither black nor white: those two are the least once 256 - kWhite is added to all, modulo 256.
uint64_t between(uint64_t word) {
  constexpr uint64_t kAdded = 256 - kWhite;
  const uint64_t shifted = ((word & ~kHighest) + kAdded * kEach) ^ (word & kHighest);
  return ~below(shifted, kAdded + kBlack + 1) & kHighest;
}

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
  uint64_t even = 0;  // bytes 0, 2, 4 of each pair of pixels: channels 0, 2, 1
  uint64_t odd = 0;   // bytes 1, 3, 5: channels 1, 0, 2
  uint32_t n_equal = 0;
  uint32_t n = 0;
  for (int row = 0; row < kHigh; ++row) {
    const uint8_t* pixels = frame.row(windows_[window].y + row) + ptrdiff_t{3} * windows_[window].x;
    const uint64_t begin = eight(pixels);
    const uint64_t end = eight(pixels + 4) >> 16;
    even += (begin & kEven) + (end & kEven);
    odd += (begin >> 8 & kEven) + (end >> 8 & kEven);
    const uint64_t shifted = eight(pixels + 3);
    const uint64_t usable = between(shifted);
    const uint64_t equal = usable & zeros(shifted ^ begin);
    const uint32_t is_last_usable = uint32_t{pixels[11]} - (kBlack + 1) < kWhite - kBlack - 1 ? 1U : 0U;
    n += count(usable) + is_last_usable;
    n_equal += count(equal) + (is_last_usable & (pixels[11] == pixels[8] ? 1U : 0U));
  }
  const auto part = [](uint64_t sums, int i) { return static_cast<int32_t>(sums >> (16 * i) & 0xffff); };
  const std::array<int32_t, 3> sum = {part(even, 0) + part(odd, 1), part(even, 2) + part(odd, 0),
                                      part(even, 1) + part(odd, 2)};
  sum_[window] = sum;
  ties.n_equal += n_equal;
  ties.n += n;
}

int64_t PixelStatistics::colour_of(const FrameView& frame) const {
  int64_t colour = 0;
  for (size_t begin = 0; begin < windows_.size(); begin += kSumWindows) {
    Lanes sum{};
    for (size_t i = begin; i < std::min(begin + kSumWindows, windows_.size()); ++i) {
      for (int row = 0; row < kHigh; ++row) {
        const uint8_t* pixels = frame.row(windows_[i].y + row) + ptrdiff_t{3} * windows_[i].x;
        // a_B a_G a_R a_B ... less a_G a_R a_B a_G ...: lanes 2 and 5 are of two pairs, and not used.
        const Lanes step = (lanes(pixels + 3) - lanes(pixels)) - (lanes(pixels + 4) - lanes(pixels + 1));
        const Lanes sign = step >> 15;
        sum += (step ^ sign) - sign;
      }
    }
    colour += sum[0] + sum[1] + sum[3] + sum[4] + sum[6] + sum[7];
  }
  return colour;
}

void PixelStatistics::add_rest(const FrameView& frame) {
  for (size_t i = 0; i < windows_.size(); ++i) add_window(frame, i, rest_ties_);
  rest_colour_ += colour_of(frame);
  ++n_rest_;
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
  bool is_more = true;
  bool is_less = true;
  int64_t both = 0;
  int64_t apart = 0;
  for (size_t c = 0; c < 3; ++c) {
    const std::span<const Level> levels = levels_[c];
    const int32_t dark = median(levels.first(levels.size() / 3), c);
    const int32_t bright = median(levels.last(levels.size() / 3), c);
    const int32_t off = dark + bright - ((gain[c] - Rest::kUnitGain) >> 7);  // twice the offset
    is_more = is_more && off > 2 * kOffQ12;
    is_less = is_less && off < -2 * kOffQ12;
    if (!is_more && !is_less) return false;  // of most frames the first channel shows it
    both += off;
    apart += bright - dark;
  }
  return (is_more && -kAgainst * apart > both) || (is_less && kAgainst * apart > -both);
}

bool PixelStatistics::is_coarse(const Ties& now, int64_t colour) const {
  // now > 1.2 rest + 0.01, as shares.
  const bool has_lost_bits = rest_ties_.n > 0 && now.n > 0 &&
                             100 * now.n_equal * rest_ties_.n > (120 * rest_ties_.n_equal + rest_ties_.n) * now.n;
  return has_lost_bits || 100 * colour * n_rest_ < kMissingPercent * rest_colour_;
}

PixelStatistics::Defects PixelStatistics::run(const FrameView& frame, const Rest::Gain& gain) {
  Ties now;
  for (size_t i = 0; i < windows_.size(); ++i) add_window(frame, i, now);
  return {.is_coarse = is_coarse(now, colour_of(frame)), .is_off_curve = has_levels_ && is_off_curve(gain)};
}

}  // namespace ruffini
