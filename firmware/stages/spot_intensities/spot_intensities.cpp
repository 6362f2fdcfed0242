#include "stages/spot_intensities/spot_intensities.h"

#include <algorithm>
#include <cstdlib>
#include <limits>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int kPixel = 8;  // fraction bits of places
constexpr int64_t kGain = 1 << 20;
constexpr int64_t kGreyOfLevel = 48;  // 12 (B + 2 G + R) of one level in each channel
constexpr int64_t kLeastLevel = 16;
constexpr int64_t kFullShare = 8;          // an eighth
constexpr int64_t kLeastShare = 16;        // a sixteenth
constexpr int kFullAtRest = 16 * 255 - 8;  // 1/16 levels
constexpr int32_t kSame = 1311;            // 2 %
constexpr int64_t kMost = 2621;            // 4 %
constexpr int64_t kStep = 512;             // 1/128, a sixteenth of which is as much in Q20
constexpr int kStillFrames = 16;

// Below 255 / 16 of rest over 0.75.
static_assert(255 / kLeastLevel + 1 <= 16 && SpotIntensities::kOne * 16 * 4 / 3 < int64_t{1} << 21);

int64_t projected_q8(int64_t at_um, int64_t size_um, int64_t center_mpx, const CameraSettings& camera) {
  return floor_div(256 * center_mpx * camera.standoff_um + 128 * (2 * at_um - size_um) * camera.focal_mpx,
                   1000 * camera.standoff_um);
}

int64_t length_q8(int64_t length_um, const CameraSettings& camera) {
  return floor_div(128 * length_um * camera.focal_mpx, 1000 * camera.standoff_um);  // half of it
}

int64_t half_up(int64_t sum, int64_t n) { return floor_div(2 * sum + n, 2 * n); }

}  // namespace

SpotIntensities::SpotIntensities(const BoardSettings& b)
    : width_px_(b.camera.width_px),
      height_px_(b.camera.height_px),
      radius_q8_(length_q8(b.markers.diameter_um, b.camera)),
      reach_x_q8_(length_q8(b.markers.pitch_x_um, b.camera)),
      reach_y_q8_(length_q8(b.markers.pitch_y_um, b.camera)),
      max_lost_(static_cast<int>(b.markers.max_lost)) {
  const MarkerSettings& m = b.markers;
  std::vector<PadPlace> places = m.places;
  if (!m.is_scattered) {
    for (int j = 0; j < m.lattice.n_y; ++j) {
      for (int i = 0; i < m.lattice.n_x; ++i) {
        places.push_back({m.first_x_um + i * m.pitch_x_um, m.first_y_um + j * m.pitch_y_um});
      }
    }
  }
  for (const PadPlace& at : places) {
    nominal_.push_back({projected_q8(at.x_um, b.pad.size_x_um, b.camera.center_x_mpx, b.camera),
                        projected_q8(at.y_um, b.pad.size_y_um, b.camera.center_y_mpx, b.camera)});
  }
  spot_.resize(nominal_.size());
  is_lost_.resize(nominal_.size(), 1);
  sorted_.resize(nominal_.size());
  run_.reserve(nominal_.size() * static_cast<size_t>((2 * radius_q8_ >> kPixel) + 2));
  find_near();
}

SpotIntensities::Place SpotIntensities::found(const Place& nominal, std::span<const uint16_t> grey) const {
  const auto pixels = [](int64_t at, int64_t reach, int n) {
    const int64_t first = std::clamp<int64_t>((at - reach) >> kPixel, 0, n);
    return std::pair(first, std::clamp<int64_t>(((at + reach) >> kPixel) + 1, first, n));
  };
  const auto [x0, x1] = pixels(nominal.x_q8, reach_x_q8_, width_px_);
  const auto [y0, y1] = pixels(nominal.y_q8, reach_y_q8_, height_px_);
  int64_t lowest = std::numeric_limits<uint16_t>::max();
  int64_t highest = 0;
  const auto at = [&](int64_t x, int64_t y) { return int64_t{grey[static_cast<size_t>(y * width_px_ + x)]}; };
  for (int64_t y = y0; y < y1; ++y) {
    for (int64_t x = x0; x < x1; ++x) {
      lowest = std::min(lowest, at(x, y));
      highest = std::max(highest, at(x, y));
    }
  }
  const int64_t threshold = (lowest + highest) / 2;
  int64_t weight = 0, sum_x = 0, sum_y = 0;
  for (int64_t y = y0; y < y1; ++y) {
    for (int64_t x = x0; x < x1; ++x) {
      const int64_t w = std::max<int64_t>(at(x, y) - threshold, 0);
      weight += w;
      sum_x += w * x;
      sum_y += w * y;
    }
  }
  if (weight == 0) return nominal;
  return {half_up(sum_x << kPixel, weight), half_up(sum_y << kPixel, weight)};
}

// Pixels whose centres lie in the disc, as runs along the rows.
void SpotIntensities::cover(Spot& spot, const Place& place) {
  spot.first_run = run_.size();
  spot.n_pixels = 0;
  const int64_t radius2 = radius_q8_ * radius_q8_;
  const auto is_inside = [&](int64_t x, int64_t y) {
    const int64_t dx = (x << kPixel) - place.x_q8;
    const int64_t dy = (y << kPixel) - place.y_q8;
    return dx * dx + dy * dy <= radius2;
  };
  const int64_t y0 = std::max<int64_t>((place.y_q8 - radius_q8_) >> kPixel, 0);
  const int64_t y1 = std::min<int64_t>((place.y_q8 + radius_q8_) >> kPixel, height_px_ - 1);
  const int64_t x0 = std::max<int64_t>((place.x_q8 - radius_q8_) >> kPixel, 0);
  const int64_t x1 = std::min<int64_t>((place.x_q8 + radius_q8_) >> kPixel, width_px_ - 1);
  for (int64_t y = y0; y <= y1; ++y) {
    int64_t first = x0;
    int64_t last = x1;
    while (first <= last && !is_inside(first, y)) ++first;
    while (last >= first && !is_inside(last, y)) --last;
    if (first > last) continue;
    run_.push_back({static_cast<int>(y), static_cast<int>(first), static_cast<int>(last)});
    spot.n_pixels += last - first + 1;
  }
  spot.n_runs = run_.size() - spot.first_run;
}

// The nearest first; of equal distances the one that is listed first. Fewer than kNear others: repeated.
void SpotIntensities::find_near() {
  const std::vector<Place>& places = nominal_;
  for (size_t k = 0; k < places.size(); ++k) {
    std::array<int64_t, kNear> best{};
    best.fill(std::numeric_limits<int64_t>::max());
    spot_[k].near.fill(k);
    for (size_t i = 0; i < places.size(); ++i) {
      if (i == k) continue;
      const int64_t dx = places[i].x_q8 - places[k].x_q8;
      const int64_t dy = places[i].y_q8 - places[k].y_q8;
      int64_t distance = dx * dx + dy * dy;
      size_t number = i;
      for (size_t n = 0; n < kNear; ++n) {
        if (distance >= best[n]) continue;
        std::swap(distance, best[n]);
        std::swap(number, spot_[k].near[n]);
      }
    }
  }
}

int64_t SpotIntensities::sum(const Spot& spot, std::span<const uint16_t> grey) const {
  int64_t out = 0;
  for (size_t i = spot.first_run; i < spot.first_run + spot.n_runs; ++i) {
    const uint16_t* row = grey.data() + static_cast<size_t>(run_[i].y) * static_cast<size_t>(width_px_);
    for (int x = run_[i].first; x <= run_[i].last; ++x) out += row[x];
  }
  return out;
}

void SpotIntensities::learn(std::span<const uint16_t> grey, std::span<const uint16_t> rest) {
  gain_q20_ = kGain;
  n_still_ = 0;
  run_.clear();
  for (size_t k = 0; k < spot_.size(); ++k) {
    Spot& spot = spot_[k];
    cover(spot, found(nominal_[k], grey));
    spot.rest = sum(spot, grey);
    int64_t n_full = 0;
    for (size_t i = spot.first_run; i < spot.first_run + spot.n_runs; ++i) {
      for (int x = run_[i].first; x <= run_[i].last; ++x) {
        const uint16_t* p = rest.data() + 3 * (static_cast<size_t>(run_[i].y) * static_cast<size_t>(width_px_) +
                                               static_cast<size_t>(x));
        n_full += std::max({p[0], p[1], p[2]}) >= kFullAtRest ? 1 : 0;
      }
    }
    spot.is_usable = spot.rest >= std::max<int64_t>(kLeastLevel * kGreyOfLevel * spot.n_pixels, 1) &&
                     kFullShare * n_full < spot.n_pixels;
  }
}

SpotIntensities::Outcome SpotIntensities::run(std::span<const uint16_t> grey, const FrameView& frame,
                                              std::span<int32_t> features, bool is_wrong) {
  for (size_t k = 0; k < spot_.size(); ++k) {
    const Spot& spot = spot_[k];
    features[k] = 0;
    is_lost_[k] = spot.is_usable ? 0 : 1;
    if (!spot.is_usable) continue;
    const int64_t now = sum(spot, grey);
    int64_t n_full = 0;
    for (size_t i = spot.first_run; i < spot.first_run + spot.n_runs; ++i) {
      const uint8_t* p = frame.row(run_[i].y) + 3 * static_cast<ptrdiff_t>(run_[i].first);
      for (int x = run_[i].first; x <= run_[i].last; ++x, p += 3) {
        n_full += p[0] == 255 || p[1] == 255 || p[2] == 255 ? 1 : 0;
      }
    }
    if (kLeastShare * now < spot.rest || kFullShare * n_full >= spot.n_pixels) {
      is_lost_[k] = 1;
      continue;
    }
    const int64_t ratio = half_up(now * kOne, spot.rest);
    features[k] = static_cast<int32_t>(half_up(ratio * kGain, gain_q20_) - kOne);
  }
  const Outcome out = follow(features, is_wrong);
  fill(features);
  return out;
}

SpotIntensities::Outcome SpotIntensities::follow(std::span<const int32_t> features, bool is_wrong) {
  Outcome out;
  auto end = sorted_.begin();
  for (size_t k = 0; k < features.size(); ++k) {
    if (is_lost_[k] != 0) {
      ++out.n_lost;
    } else {
      *end++ = features[k];
    }
  }
  std::sort(sorted_.begin(), end);
  const auto n_seen = static_cast<size_t>(end - sorted_.begin());
  size_t first = 0;  // of the group, and how many it has
  size_t n = 0;
  for (size_t low = 0, high = 0; high < n_seen; ++high) {
    while (sorted_[high] - sorted_[low] > kSame) ++low;
    if (high - low + 1 > n) {
      first = low;
      n = high - low + 1;
    }
  }
  const int64_t light = n == 0 ? 0 : sorted_[first + n / 2];
  out.is_light_wrong = n > 0 && 2 * n >= n_seen && std::abs(light) > kMost;
  const bool is_still = n > 0 && n == n_seen && !out.is_light_wrong && !is_wrong && out.n_lost <= max_lost_;
  n_still_ = is_still ? std::min(n_still_ + 1, kStillFrames) : 0;
  if (n_still_ == kStillFrames) {
    gain_q20_ =
        std::clamp<int64_t>(gain_q20_ + std::clamp<int64_t>(light, -kStep, kStep), kGain * 3 / 4, kGain * 5 / 4);
  }
  return out;
}

void SpotIntensities::fill(std::span<int32_t> features) const {
  for (size_t k = 0; k < spot_.size(); ++k) {
    if (is_lost_[k] == 0) continue;
    int64_t total = 0;
    int64_t n = 0;
    for (const size_t i : spot_[k].near) {
      if (is_lost_[i] != 0) continue;
      total += features[i];
      ++n;
    }
    features[k] = n == 0 ? 0 : static_cast<int32_t>(half_up(total, n));
  }
}

}  // namespace ruffini
