#include "image/light_map.h"

#include <algorithm>
#include <cstdlib>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int kOrder = 4;
constexpr int64_t kOneQ12 = 4'096;
constexpr int kSampleWidthPx = 8;
constexpr int64_t kWeakestShare = 256;     // minimum of a term's square over the samples, as 1/n of the constant's
constexpr int32_t kMaxChangeQ16 = 16'384;  // a quarter
constexpr int32_t kWideQ16 = 983;          // 1.5 %
constexpr int32_t kGateQ16 = 328;          // 0.5 %: one and a half times the noise of a sample in a dark corner of rest
constexpr int32_t kEdgeQ16 = 655;          // 1 %: three times that
constexpr size_t kOutShare = 32;           // at most one of this many samples may exceed kEdgeQ16
constexpr int kRounds = 3;
constexpr int64_t kMaxStepQ24 = 4'096;                   // 1/4096 per window
constexpr int kStepShift = 2;                            // a quarter of the fitted change
constexpr int kRateShift = 6;                            // a 64th: 17 s at 60 Hz
constexpr int kRateDecayShift = 8;                       // decays in 68 s at 60 Hz, like warming lamps
constexpr int64_t kMaxCoefficientQ24 = 1 << 21;          // an eighth
constexpr int64_t kStaleQ32 = (int64_t{1} << 32) / 100;  // 1 %
constexpr int64_t kFarQ16 = 262;                         // 0.4 %: four times the lag at the largest step
constexpr int64_t kUnlikeQ16 = 655;  // 1 %: touches too faint to move a marker cause 0.35 % on the twin
constexpr int32_t kSettled = Rest::kUnitGain / 2'048;  // four times the noise of a corner

// P_0 to P_4 at u, all Q14.
std::array<int64_t, kOrder + 1> legendre(int64_t u) {
  constexpr int64_t kOne = 16'384;
  const int64_t u2 = round_shift(u * u, 14);
  const int64_t u4 = round_shift(u2 * u2, 14);
  return {kOne, u, (3 * u2 - kOne) >> 1, round_shift(u * (5 * u2 - 3 * kOne), 15), (35 * u4 - 30 * u2 + 3 * kOne) >> 3};
}

// Maps twice a pixel's position on an axis of n pixels to -1..1 from the first to the last pixel, Q14.
int64_t place(int64_t twice_px, int n) {
  return std::clamp<int64_t>(floor_div((twice_px - (n - 1)) * 16'384, n - 1), -16'384, 16'384);
}

}  // namespace

LightMap::LightMap(int width_px, int height_px)
    : width_px_(width_px),
      height_px_(height_px),
      nodes_(Rest::map_nodes(width_px, height_px)),
      term_size_(kMaxSamples + static_cast<size_t>(nodes_.count())),
      sample_(kMaxSamples),
      basis_(kTerms * term_size_),
      fitted_(kMaxSamples),
      sorted_(kMaxSamples),
      is_out_(kMaxSamples),
      factor_(3 * static_cast<size_t>(nodes_.count()), Rest::kUnitGain),
      in_force_(factor_) {
  for (auto& channel : sum_) channel.resize(kMaxSamples);
}

std::span<int16_t> LightMap::basis(size_t term) { return {basis_.data() + term * term_size_, term_size_}; }

void LightMap::learn(std::span<const int32_t> sample_at) {
  const size_t step = (sample_at.size() + kMaxSamples - 1) / kMaxSamples;
  n_samples_ = step == 0 ? 0 : (sample_at.size() + step - 1) / step;
  if (n_samples_ < kMinSamples) n_samples_ = 0;
  const auto put = [&](size_t at, int64_t u, int64_t v) {
    const auto along_x = legendre(u);
    const auto along_y = legendre(v);
    size_t term = 0;
    for (size_t order = 0; order <= kOrder; ++order) {
      for (size_t i = 0; i <= order; ++i)
        basis(term++)[at] = static_cast<int16_t>(round_shift(along_x[order - i] * along_y[i], 16));
    }
  };
  for (size_t i = 0; i < n_samples_; ++i) {
    sample_[i] = i * step;
    const int64_t at = sample_at[i * step];
    put(i, place(2 * (at % width_px_) + kSampleWidthPx - 1, width_px_), place(2 * (at / width_px_) + 1, height_px_));
  }
  for (int64_t i = 0; i < nodes_.count(); ++i) {
    const int64_t x_px = i % nodes_.n_x * Rest::kNodePx;
    const int64_t y_px = i / nodes_.n_x * Rest::kNodePx;
    put(kMaxSamples + static_cast<size_t>(i), place(2 * x_px, width_px_), place(2 * y_px, height_px_));
  }
  for (size_t term = 0; n_samples_ > 0 && term < kTerms; ++term) orthogonalise(term);
  n_frames_ = 0;
  is_unmatched_ = is_at_limit_ = is_stale_ = false;
  coefficient_ = rate_ = extrapolated_ = {};
  gain_before_ = Rest::unit_gain();
  std::fill(factor_.begin(), factor_.end(), Rest::kUnitGain);
  in_force_ = factor_;
}

// Modified Gram-Schmidt: the earlier terms are orthogonal already.
void LightMap::orthogonalise(size_t term) {
  const auto q = basis(term);
  for (size_t before = 0; before < term; ++before) {
    if (square_[before] == 0) continue;
    const auto p = basis(before);
    int64_t product = 0;
    for (size_t i = 0; i < n_samples_; ++i) product += int64_t{q[i]} * p[i];
    const int64_t share_q12 = floor_div(2 * product * kOneQ12 + square_[before], 2 * square_[before]);
    for (size_t i = 0; i < q.size(); ++i) {
      if (i >= n_samples_ && i < kMaxSamples) continue;
      q[i] = static_cast<int16_t>(std::clamp<int64_t>(q[i] - round_shift(share_q12 * p[i], 12), -32'768, 32'767));
    }
  }
  int64_t square = 0;
  for (size_t i = 0; i < n_samples_; ++i) square += int64_t{q[i]} * q[i];
  const bool is_told = square * kWeakestShare >= static_cast<int64_t>(n_samples_) * kOneQ12 * kOneQ12;
  square_[term] = is_told ? square : 0;
  if (!is_told) std::fill(q.begin(), q.end(), int16_t{0});
}

bool LightMap::run(const Samples& sample, PadState pad, bool is_gain_followed, Rest::Gain& gain) {
  if (n_samples_ == 0) return false;
  if (n_frames_ == 0) {
    for (auto& channel : sum_) std::fill(channel.begin(), channel.end(), 0);
    pad_ = PadState::kAtRest;
  }
  pad_ = std::min(pad_, pad);
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < n_samples_; ++i) sum_[c][i] += sample[c][sample_[i]];
  }
  if (++n_frames_ < kWindowFrames) return false;
  n_frames_ = 0;
  end_window(is_gain_followed, gain);
  make_factors();
  const auto is_settled = [](int32_t now, int32_t before) { return std::abs(now - before) < kSettled; };
  if (std::equal(factor_.begin(), factor_.end(), in_force_.begin(), is_settled)) return false;
  in_force_ = factor_;
  return true;
}

// Fits the polynomial to a channel's samples, Q24, and marks the samples beyond the gate.
void LightMap::fit(size_t channel, Terms& a) {
  static_assert(kWindowFrames == 16);  // sums of Q12 are means in Q16
  auto& r = sum_[channel];
  const auto n = static_cast<ptrdiff_t>(n_samples_);
  for (int32_t& value : r) value = std::clamp(value, -kMaxChangeQ16, kMaxChangeQ16);
  std::copy_n(r.begin(), n, sorted_.begin());
  std::nth_element(sorted_.begin(), sorted_.begin() + n / 2, sorted_.begin() + n);
  const int32_t median = sorted_[n_samples_ / 2];
  std::fill_n(fitted_.begin(), n, median);
  a.fill(0);
  for (int round = 0; round < kRounds; ++round) {
    for (size_t i = 0; i < n_samples_; ++i) {
      const int32_t e = r[i] - fitted_[i];
      sorted_[i] = round == 0 ? std::clamp(e, -kWideQ16, kWideQ16) : std::abs(e) > kGateQ16 ? 0 : e;
    }
    for (size_t k = 0; k < kTerms; ++k) {
      if (square_[k] == 0) continue;
      const auto q = basis(k);
      int64_t product = 0;
      for (size_t i = 0; i < n_samples_; ++i) product += int64_t{sorted_[i]} * q[i];
      a[k] += floor_div(2 * product * (int64_t{1} << 20) + square_[k], 2 * square_[k]);
    }
    for (size_t i = 0; i < n_samples_; ++i) {
      const int16_t* q = basis_.data() + i;
      int64_t sum = 0;
      for (size_t k = 0; k < kTerms; ++k) sum += a[k] * q[k * term_size_];
      fitted_[i] = median + static_cast<int32_t>(round_shift(sum, 20));
    }
  }
  const int64_t level = median + round_shift(a[0], 8);
  for (size_t i = 0; i < n_samples_; ++i) {
    if (std::abs(r[i] - fitted_[i]) > kEdgeQ16) is_out_[i] = 1;
    farthest_q16_ = std::max<int64_t>(farthest_q16_, std::abs(fitted_[i] - level));
  }
  a[0] += int64_t{median} * 256;
}

void LightMap::end_window(bool is_gain_followed, Rest::Gain& gain) {
  if (pad_ == PadState::kTouched) return extrapolate(gain);
  std::array<Terms, 3> a;
  std::fill(is_out_.begin(), is_out_.end(), uint8_t{0});
  farthest_q16_ = 0;
  for (size_t c = 0; c < 3; ++c) fit(c, a[c]);
  const auto n_out = static_cast<size_t>(std::count(is_out_.begin(), is_out_.end(), uint8_t{1}));
  const bool is_smooth = n_out * kOutShare <= n_samples_;
  if (is_smooth) {
    is_unmatched_ = farthest_q16_ > kFarQ16;
  } else if (pad_ == PadState::kAtRest) {
    is_unmatched_ = farthest_q16_ > kUnlikeQ16;
  }
  if (!is_smooth || (is_unmatched_ && pad_ == PadState::kUnknown)) return extrapolate(gain);
  follow(a, is_gain_followed, gain);
}

void LightMap::follow(const std::array<Terms, 3>& a, bool is_gain_followed, Rest::Gain& gain) {
  is_at_limit_ = is_stale_ = false;
  extrapolated_ = {};
  for (size_t c = 0; c < 3; ++c) {
    for (size_t k = 0; k < kTerms; ++k) {
      const int64_t whole = a[c][k] >> kStepShift;
      int64_t step = std::clamp(whole, -kMaxStepQ24, kMaxStepQ24);
      bool is_steady = step == whole;
      if (k > 0) {
        coefficient_[c][k] += step;
      } else if (is_gain_followed) {
        step = int64_t{gain[c] - gain_before_[c]} * 16;
        is_steady = std::abs(step) <= kMaxStepQ24;
      } else {
        gain[c] = Rest::clamp_gain(gain[c] + (step >> 4));
      }
      if (is_steady) rate_[c][k] += (step * 256 - rate_[c][k]) >> kRateShift;
      is_at_limit_ = is_at_limit_ || std::abs(coefficient_[c][k]) > kMaxCoefficientQ24;
      coefficient_[c][k] = std::clamp(coefficient_[c][k], -kMaxCoefficientQ24, kMaxCoefficientQ24);
    }
  }
  gain_before_ = gain;
}

void LightMap::extrapolate(Rest::Gain& gain) {
  for (size_t c = 0; c < 3; ++c) {
    for (size_t k = 0; k < kTerms; ++k) {
      const int64_t before = extrapolated_[c][k];
      extrapolated_[c][k] += rate_[c][k];
      rate_[c][k] -= rate_[c][k] >> kRateDecayShift;
      const int64_t step = (extrapolated_[c][k] >> 8) - (before >> 8);
      if (k > 0) {
        coefficient_[c][k] = std::clamp(coefficient_[c][k] + step, -kMaxCoefficientQ24, kMaxCoefficientQ24);
      } else {
        gain[c] = Rest::clamp_gain(gain[c] + (extrapolated_[c][k] >> 12) - (before >> 12));
      }
      is_stale_ = is_stale_ || std::abs(extrapolated_[c][k]) > kStaleQ32;
    }
  }
  gain_before_ = gain;
}

void LightMap::make_factors() {
  const auto n = static_cast<size_t>(nodes_.count());
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < n; ++i) {
      int64_t sum = 0;
      for (size_t k = 1; k < kTerms; ++k) sum += coefficient_[c][k] * basis(k)[kMaxSamples + i];
      factor_[c * n + i] = Rest::clamp_gain(Rest::kUnitGain + round_shift(sum, 16));
    }
  }
}

}  // namespace ruffini
