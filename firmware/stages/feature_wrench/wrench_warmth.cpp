#include "stages/feature_wrench/wrench_warmth.h"

#include <algorithm>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int kGainFraction = 30;
constexpr int kFactorFraction = 20;
constexpr int kOffsetFraction = 10;
constexpr int32_t kMaxGain = 1 << 15;    // 3 % a kelvin
constexpr int32_t kMaxOffset = 1 << 26;  // 4 N or N mm a kelvin
constexpr int32_t kMaxMilliCelsius = 300'000;
constexpr int64_t kMaxDifferenceMk = 100'000;
constexpr int64_t kBeyondMk = 10'000;

// e times the factor stays inside 63 bits.
static_assert((int64_t{kMaxGain} * kMaxDifferenceMk >> (kGainFraction - kFactorFraction)) < int64_t{1} << 22);

}  // namespace

Result<WrenchWarmth> WrenchWarmth::load(const Calibration& c) {
  WrenchWarmth out;
  if (c.tensor("wrench.warm_mc") == nullptr) return out;
  auto limits = c.tensor("wrench.warm_mc", Tensor::Type::kI32, {3});
  if (!limits) return limits.error();
  auto gain = c.tensor("wrench.warm_gain", Tensor::Type::kI32, {int64_t{kAxes}});
  if (!gain) return gain.error();
  auto offset = c.tensor("wrench.warm_offset", Tensor::Type::kI32, {int64_t{kAxes}});
  if (!offset) return offset.error();
  const auto t = limits.value()->as<int32_t>();
  const auto g = gain.value()->as<int32_t>();
  const auto o = offset.value()->as<int32_t>();
  const auto are_within = [](std::span<const int32_t> values, int32_t limit) {
    return std::all_of(values.begin(), values.end(), [&](int32_t v) { return v >= -limit && v <= limit; });
  };
  if (!are_within(t, kMaxMilliCelsius) || t[1] > t[2] || !are_within(g, kMaxGain) || !are_within(o, kMaxOffset)) {
    return Error{
        ErrorKind::kBadInput,
        "calibration file: a number of wrench.warm_* is out of range: make it again with cal fit --only wrench"};
  }
  out.is_loaded_ = true;
  out.reference_mc_ = t[0];
  out.coldest_mc_ = t[1];
  out.warmest_mc_ = t[2];
  std::copy(g.begin(), g.end(), out.gain_q30_.begin());
  std::copy(o.begin(), o.end(), out.offset_q10_.begin());
  return out;
}

bool WrenchWarmth::correct(Axes& e, const Warmth& warmth) const {
  if (!is_loaded_) return true;
  if (!warmth.now_mc) return false;
  const int64_t now = *warmth.now_mc;
  if (now < coldest_mc_ - kBeyondMk || now > warmest_mc_ + kBeyondMk) return false;
  const auto since = [&](int64_t then) { return std::clamp(now - then, -kMaxDifferenceMk, kMaxDifferenceMk); };
  const int64_t since_rest_mk = since(warmth.rest_mc ? *warmth.rest_mc : reference_mc_);
  const int64_t since_reference_mk = since(reference_mc_);
  for (size_t i = 0; i < kAxes; ++i) {
    e[i] -= round_shift(offset_q10_[i] * since_rest_mk, kOffsetFraction);
    const int64_t factor_q20 = round_shift(gain_q30_[i] * since_reference_mk, kGainFraction - kFactorFraction);
    e[i] += round_shift(e[i] * factor_q20, kFactorFraction);
  }
  return true;
}

}  // namespace ruffini
