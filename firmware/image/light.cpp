#include "image/light.h"

#include <algorithm>
#include <cstdlib>

namespace ruffini {
namespace {

constexpr int kSamplePx = 8;
constexpr int kStepX = 16;
constexpr int kStepY = 8;
constexpr int kFirst = 4;
constexpr uint16_t kUsableLow = 16 * 32;  // below it a ratio is unreliable (rest.h)
constexpr uint16_t kUsableHigh = 16 * 220;
constexpr int kLevelQ12 = 61;  // 1.5 %: three times the noise of a sample with a typical camera
constexpr int kNearQ12 = 328;  // 8 %: more than the slopes of half an image, less than those of a contact
constexpr int kRounds = 3;
constexpr int32_t kMaxLevelQ16 = 65'536 / 4;
constexpr ptrdiff_t kMinOfSide = 4;                    // samples
constexpr int kMaxStepQ12 = 32;                        // 1/128
constexpr int kStepShift = 8 - 4;                      // Q12 to Q20, a sixteenth
constexpr int kStillFrames = 16;                       // a quarter of a second at 60 Hz
constexpr int kStillPxQ16 = 65'536 / 4;                // six times the noise of a marker
constexpr int kOffStillQ12 = 164;                      // 4 %
constexpr int kOffAllQ12 = 3 * 246;                    // 18 %: 6 % in the mean of three channels
constexpr int32_t kSettled = Rest::kUnitGain / 4'096;  // four times the noise of the gain

PadState state_of(std::span<const Marker> markers) {
  auto state = PadState::kUnknown;
  for (const Marker& m : markers) {
    if (m.is_lost) continue;
    if (std::abs(m.displacement_x.raw()) > kStillPxQ16 || std::abs(m.displacement_y.raw()) > kStillPxQ16)
      return PadState::kTouched;
    state = PadState::kAtRest;
  }
  return state;
}

// True if a row of a sample is bright enough, not saturated, and without the edge of a dot.
bool is_usable(std::span<const uint16_t> pixels) {
  for (size_t c = 0; c < 3; ++c) {
    uint16_t least = pixels[c];
    uint16_t most = pixels[c];
    for (size_t i = c; i < pixels.size(); i += 3) {
      least = std::min(least, pixels[i]);
      most = std::max(most, pixels[i]);
    }
    if (least < kUsableLow || most > kUsableHigh || 4 * least < 3 * most) return false;
  }
  return true;
}

}  // namespace

LightTracker::LightTracker(int width_px, int height_px)
    : width_px_(width_px),
      height_px_(height_px),
      gain_(Rest::unit_gain()),
      in_force_(gain_),
      map_(width_px, height_px) {
  const int n_x = (width_px + kStepX - kFirst - kSamplePx) / kStepX;
  const int n_y = (height_px + kStepY - kFirst - 2) / kStepY;
  sample_at_.resize(static_cast<size_t>(n_x * n_y));
  for (std::vector<int16_t>& channel : sample_) channel.resize(sample_at_.size());
  sorted_.resize(sample_at_.size());
  side_.resize(sample_at_.size());
}

void LightTracker::learn(std::span<const uint16_t> rest, bool has_map) {
  n_samples_ = 0;
  const auto row = [&](int x, int y) {
    return rest.subspan(size_t{3} * static_cast<size_t>(y * width_px_ + x), size_t{3} * kSamplePx);
  };
  for (int y = kFirst; y + 1 < height_px_; y += kStepY) {
    for (int x = kFirst; x + kSamplePx <= width_px_; x += kStepX) {
      if (!is_usable(row(x, y)) || !is_usable(row(x, y + 1))) continue;
      const int across = 3 * x < width_px_ ? kLeft : 3 * x >= 2 * width_px_ ? kRight : 0;
      const int down = 3 * y < height_px_ ? kTop : 3 * y >= 2 * height_px_ ? kBottom : 0;
      side_[n_samples_] = static_cast<uint8_t>(across + down);
      sample_at_[n_samples_++] = y * width_px_ + x;
    }
  }
  n_still_ = 0;
  is_wrong_ = false;
  gain_ = in_force_ = Rest::unit_gain();
  map_.learn({sample_at_.data(), has_map ? n_samples_ : 0});
}

void LightTracker::sample(std::span<const RelativeChange> change) {
  const size_t n_pixels = change.size() / 3;
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < n_samples_; ++i) {
      const auto* upper = &change[c * n_pixels + static_cast<size_t>(sample_at_[i])];
      const auto* lower = upper + width_px_;
      int sum = kSamplePx;
      for (int k = 0; k < kSamplePx; ++k) sum += upper[k].raw() + lower[k].raw();
      sample_[c][i] = static_cast<int16_t>(sum >> 4);
    }
  }
}

LightTracker::Level LightTracker::level_of(size_t channel) {
  const auto end = std::copy_n(sample_[channel].begin(), n_samples_, sorted_.begin());
  const auto middle = sorted_.begin() + static_cast<ptrdiff_t>(n_samples_ / 2);
  std::nth_element(sorted_.begin(), middle, end);
  const int median = *middle;
  const auto n = std::count_if(sorted_.begin(), end, [&](int16_t d) { return std::abs(d - median) <= kLevelQ12; });
  return {median, static_cast<size_t>(n)};
}

void LightTracker::measure(const std::array<Level, 3>& start) {
  for (size_t c = 0; c < 3; ++c) level_[c] = start[c].median * 16;
  is_level_reliable_ = true;
  for (int round = 0; round < kRounds && is_level_reliable_; ++round) {
    std::array<int64_t, 3> sum{};
    int64_t n = 0;
    for (size_t i = 0; i < n_samples_; ++i) {
      const auto is_near = [&](size_t c) { return std::abs(sample_[c][i] * 16 - level_[c]) <= kNearQ12 * 16; };
      if (!is_near(0) || !is_near(1) || !is_near(2)) continue;
      for (size_t c = 0; c < 3; ++c) sum[c] += sample_[c][i];
      ++n;
    }
    is_level_reliable_ = 8 * n >= static_cast<int64_t>(n_samples_);
    for (size_t c = 0; c < 3 && is_level_reliable_; ++c)
      level_[c] = static_cast<int32_t>(floor_div(32 * sum[c] + n, 2 * n));
  }
  for (int32_t& m : level_) {
    is_level_reliable_ = is_level_reliable_ && std::abs(m) <= kMaxLevelQ16;
    m = std::clamp(m, -kMaxLevelQ16, kMaxLevelQ16);
  }
}

void LightTracker::run(std::span<const RelativeChange> change, std::span<const Marker> markers, Rest& rest) {
  is_wrong_ = false;
  is_level_reliable_ = false;
  level_.fill(0);
  if (n_samples_ == 0) return;
  sample(change);
  std::array<Level, 3> level;
  size_t n_level = n_samples_;
  int all = 0;
  int most = 0;
  for (size_t c = 0; c < 3; ++c) {
    level[c] = level_of(c);
    n_level = std::min(n_level, level[c].n_level);
    all += level[c].median;
    most = std::max(most, std::abs(level[c].median));
  }
  measure(level);
  const PadState pad = state_of(markers);
  const bool is_still = 8 * n_level >= 7 * n_samples_ && pad != PadState::kTouched;
  is_wrong_ = (is_still && most > kOffStillQ12) || (2 * n_level >= n_samples_ && std::abs(all) > kOffAllQ12) ||
              (6 * n_level < 5 * n_samples_ && pad == PadState::kAtRest);
  // Without markers the samples alone say that nothing touches.
  const bool is_free = pad != PadState::kUnknown || 128 * n_level >= 127 * n_samples_;
  n_still_ = is_still && is_free ? std::min(n_still_ + 1, kStillFrames) : 0;
  const bool is_followed = n_still_ == kStillFrames;
  if (is_followed) follow(level);
  rest.advance();
  if (map_.run(sample_, pad, is_followed, gain_)) rest.set_map(map_.factor());
  const auto is_settled = [](int32_t now, int32_t before) { return std::abs(now - before) < kSettled; };
  if (std::equal(gain_.begin(), gain_.end(), in_force_.begin(), is_settled)) return;
  in_force_ = gain_;
  rest.set_gain(gain_);
}

bool LightTracker::is_lit_from_outside(int more_q12, const LightLevel& level) const {
  size_t n_brighter = 0;
  for (size_t i = 0; i < n_samples_; ++i) {
    const auto more_q16 = [&](size_t c) { return sample_[c][i] * 16 - level[c]; };
    n_brighter += std::min({more_q16(0), more_q16(1), more_q16(2)}) > 16 * more_q12 ? 1U : 0U;
  }
  return n_samples_ > 0 && 8 * n_brighter >= n_samples_;
}

std::optional<int> LightTracker::median_of(size_t channel, Side side) {
  auto end = sorted_.begin();
  for (size_t i = 0; i < n_samples_; ++i) {
    if ((side_[i] & side) != 0) *end++ = sample_[channel][i];
  }
  const ptrdiff_t n = end - sorted_.begin();
  if (n < kMinOfSide) return {};
  std::nth_element(sorted_.begin(), sorted_.begin() + n / 2, end);
  return sorted_[static_cast<size_t>(n / 2)];
}

// True if one side is brighter than the other in all channels, whichever of the two it is.
bool LightTracker::are_unequal(Side one, Side other) {
  int n_brighter = 0;  // channels
  for (size_t c = 0; c < 3; ++c) {
    const auto here = median_of(c, one);
    const auto there = median_of(c, other);
    if (!here || !there) return false;
    const int more = *here - *there;
    if (std::abs(more) <= kSideQ12) return false;
    n_brighter += more > 0 ? 1 : 0;
  }
  return n_brighter == 0 || n_brighter == 3;
}

bool LightTracker::is_lit_from_one_side() { return are_unequal(kLeft, kRight) || are_unequal(kTop, kBottom); }

void LightTracker::follow(const std::array<Level, 3>& level) {
  for (size_t c = 0; c < 3; ++c) {
    const int step = std::clamp(level[c].median, -kMaxStepQ12, kMaxStepQ12) * (1 << kStepShift);
    gain_[c] = Rest::clamp_gain(gain_[c] + step);
  }
}

}  // namespace ruffini
