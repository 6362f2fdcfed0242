#include "stages/feature_wrench/feature_wrench.h"

#include <algorithm>
#include <cstdlib>
#include <numeric>
#include <string>

#include "solve/node_sigma.h"
#include "solve/relaxation.h"

namespace ruffini {
namespace {

constexpr int kFine = 4;  // fraction bits of forces inside
constexpr int kScaledFraction = 14;
constexpr int64_t kMaxScaled = int64_t{2} << kScaledFraction;
constexpr int64_t kInRange = int64_t{5} << (kScaledFraction - 2);
constexpr int64_t kFitted =
    int64_t{1} << kScaledFraction;                // a kernel says nothing beyond the loads that it was fitted on
constexpr int64_t kMaxOutside = int64_t{4} << 8;  // |u| of the error stays below 5 + 4
constexpr int64_t kMaxForce = int64_t{1} << 36;   // 4,295 N in 1/16 uN
constexpr int32_t kMaxEntry = 1 << 26;
constexpr int kMaxShift = 40;
constexpr int32_t kMaxTolerance = 1 << 26;
constexpr int32_t kMaxFullScaleUn = 1 << 30;  // 1,074 N
constexpr int32_t kMaxSigma = 1 << 25;        // 34 N; times |u| of 5 its square still leaves room for twelve
constexpr int kPartFraction = 20;
constexpr int32_t kWhole = 1 << kPartFraction;
constexpr int32_t kMaxTimeMs = 1'000'000;

// Sums stay inside 63 bits: K f, q u u, G u + H u u.
constexpr int64_t kMaxGainSum = int64_t{1} << 36;  // of a row of K, without signs: the loader sees to it
static_assert(kMaxGainSum <= (int64_t{1} << 62) / FeatureWrench::kMaxFeature);
static_assert(int64_t{FeatureWrench::kPairs + FeatureWrench::kAxes} * kMaxEntry * kMaxScaled * 2 < int64_t{1} << 62);

Error refused(const std::string& what) {
  return {ErrorKind::kBadInput, "calibration file: " + what + ": make it again with cal fit --only wrench"};
}

bool are_within(std::span<const int32_t> values, int32_t low, int32_t high) {
  return std::all_of(values.begin(), values.end(), [&](int32_t v) { return v >= low && v <= high; });
}

bool are_summable(std::span<const int32_t> row) {
  return std::accumulate(row.begin(), row.end(), int64_t{0},
                         [](int64_t sum, int32_t v) { return sum + std::abs(v); }) <= kMaxGainSum;
}

// The products u_j u_k, j <= k by rows, Q14.
std::array<int64_t, FeatureWrench::kPairs> products(const std::array<int64_t, FeatureWrench::kAxes>& u) {
  std::array<int64_t, FeatureWrench::kPairs> out;
  size_t at = 0;
  for (size_t j = 0; j < u.size(); ++j) {
    for (size_t k = j; k < u.size(); ++k) out[at++] = round_shift(u[j] * u[k], kScaledFraction);
  }
  return out;
}

int64_t part_of(int64_t value, int64_t part_q20) { return round_shift(value * part_q20, kPartFraction); }

}  // namespace

Result<FeatureWrench> FeatureWrench::load(const Calibration& c, std::string_view features, int n_features) {
  FeatureWrench out;
  out.n_ = static_cast<size_t>(n_features);
  if (c.text("wrench.features") != features) {
    return Error{ErrorKind::kRefused, "calibration is for a wrench from \"" + std::string(c.text("wrench.features")) +
                                          "\", this board has \"" + std::string(features) + "\": use the right file"};
  }
  auto gain = c.tensor("wrench.gain", Tensor::Type::kI32, {kAxes, n_features});
  if (!gain) return gain.error();
  auto shift = c.tensor("wrench.shift", Tensor::Type::kU8, {kAxes});
  if (!shift) return shift.error();
  auto full = c.tensor("wrench.full_scale", Tensor::Type::kI32, {kAxes});
  if (!full) return full.error();
  auto square = c.tensor("wrench.square", Tensor::Type::kI32, {kAxes, kPairs});
  if (!square) return square.error();
  const Status coarse = out.load_square_shift(c);
  if (!coarse) return coarse.error();
  auto error = c.tensor("wrench.error", Tensor::Type::kI32, {2, kAxes, kAxes});
  if (!error) return error.error();
  const auto g = gain.value()->as<int32_t>();
  const auto q = square.value()->as<int32_t>();
  const auto f = full.value()->as<int32_t>();
  const auto s = shift.value()->as<uint8_t>();
  const auto v = error.value()->as<int32_t>();
  if (n_features > kMaxFeatures || !are_within(g, -kMaxEntry, kMaxEntry) || !are_within(q, -kMaxEntry, kMaxEntry) ||
      !are_within(f, 0, kMaxFullScaleUn) || !are_within(v, -kMaxSigma, kMaxSigma) ||
      std::any_of(s.begin(), s.end(), [](uint8_t each) { return each < 1 || each > kMaxShift; })) {
    return refused("a number of wrench.* is out of range");
  }
  for (size_t i = 0; i < kAxes; ++i) {
    if (!are_summable(g.subspan(i * out.n_, out.n_))) return refused("a row of wrench.gain sums to more than 2^36");
  }
  out.gain_.assign(g.begin(), g.end());
  out.square_.assign(q.begin(), q.end());
  for (size_t i = 0; i < kAxes; ++i) {
    out.shift_[i] = s[i];
    out.full_scale_[i] = int64_t{f[i]} << kFine;
    for (size_t part = 0; part < 2; ++part) {
      for (size_t k = 0; k < kAxes; ++k) out.error_[part][i][k] = v[(part * kAxes + i) * kAxes + k];
    }
  }
  const Status agreement = out.load_agreement(c);
  if (!agreement) return agreement.error();
  auto kernel = KernelMap::load(c, n_features);
  if (!kernel) return kernel.error();
  out.kernel_ = std::move(kernel.value());
  auto rest = RestGate::load(c, n_features);
  if (!rest) return rest.error();
  out.rest_ = std::move(rest.value());
  out.held_.resize(out.n_);
  auto warmth = WrenchWarmth::load(c);
  if (!warmth) return warmth.error();
  out.warmth_ = warmth.value();
  const Status relaxation = out.load_relaxation(c);
  if (!relaxation) return relaxation.error();
  return out;
}

Status FeatureWrench::load_square_shift(const Calibration& c) {
  if (c.tensor("wrench.square_shift") == nullptr) return Unit{};
  auto shift = c.tensor("wrench.square_shift", Tensor::Type::kU8, {kAxes});
  if (!shift) return shift.error();
  const auto s = shift.value()->as<uint8_t>();
  if (std::any_of(s.begin(), s.end(), [](uint8_t each) { return each >= kScaledFraction; })) {
    return refused("wrench.square_shift is out of range");
  }
  std::copy(s.begin(), s.end(), square_shift_.begin());
  return Unit{};
}

Status FeatureWrench::load_agreement(const Calibration& c) {
  if (c.tensor("wrench.forward") == nullptr) return Unit{};
  const auto n = static_cast<int64_t>(n_);
  auto forward = c.tensor("wrench.forward", Tensor::Type::kI32, {n, kAxes + kPairs});
  if (!forward) return forward.error();
  auto tolerance = c.tensor("wrench.tolerance", Tensor::Type::kI32, {n});
  if (!tolerance) return tolerance.error();
  const auto f = forward.value()->as<int32_t>();
  const auto t = tolerance.value()->as<int32_t>();
  if (!are_within(f, -kMaxEntry, kMaxEntry) || !are_within(t, 1, kMaxTolerance)) {
    return refused("wrench.forward or wrench.tolerance is out of range");
  }
  forward_.assign(f.begin(), f.end());
  tolerance_.assign(t.begin(), t.end());
  return Unit{};
}

Status FeatureWrench::load_relaxation(const Calibration& c) {
  const Tensor* time = c.tensor("wrench.relax_time_ms");
  if (time == nullptr) return Unit{};
  if (time->type != Tensor::Type::kI32 || time->shape.size() != 1 || time->shape[0] > kMaxTerms) {
    return refused("wrench.relax_time_ms has another type or shape");
  }
  auto part = c.tensor("wrench.relax_part", Tensor::Type::kI32, {time->shape[0], kAxes});
  if (!part) return part.error();
  const auto times = time->as<int32_t>();
  const auto parts = part.value()->as<int32_t>();
  if (!are_within(times, 1, kMaxTimeMs) || !are_within(parts, -kWhole, kWhole)) {
    return refused("wrench.relax_time_ms or wrench.relax_part is out of range");
  }
  for (size_t t = 0; t < times.size(); ++t) {
    Term& term = terms_.emplace_back();
    term.time_us = int64_t{1000} * times[t];
    for (size_t i = 0; i < kAxes; ++i) term.part_q20[i] = parts[t * kAxes + i];
  }
  return Unit{};
}

FeatureWrench::Axes FeatureWrench::linear(std::span<const int32_t> features, SaturationCounter& saturations) const {
  Axes y{};
  for (size_t i = 0; i < kAxes; ++i) {
    int64_t sum = 0;
    for (size_t m = 0; m < n_; ++m) {
      sum += int64_t{gain_[i * n_ + m]} * features[m];
    }
    const int64_t exact = round_shift(sum, shift_[i]);
    y[i] = std::clamp(exact, -kMaxForce, kMaxForce);
    if (y[i] != exact) ++saturations.count;
  }
  return y;
}

Wrench FeatureWrench::linear_part(std::span<const int32_t> features) const {
  SaturationCounter saturations;  // its own: no force is the worse
  const Axes y = linear(features, saturations);
  const auto force = [&](size_t i) { return measures(i) ? round_shift(y[i], kFine) : 0; };
  return {force(0), force(1), force(2), 0, 0, 0};
}

FeatureWrench::Axes FeatureWrench::scaled_q14(const Axes& y) const {
  Axes u{};
  for (size_t i = 0; i < kAxes; ++i) {
    if (!measures(i)) continue;
    u[i] =
        std::clamp(floor_div((y[i] << kScaledFraction) + full_scale_[i] / 2, full_scale_[i]), -kMaxScaled, kMaxScaled);
  }
  return u;
}

bool FeatureWrench::agrees(std::span<const int32_t> features, const Axes& s) const {
  if (forward_.empty()) return true;
  const auto pairs = products(s);
  const int32_t* row = forward_.data();
  for (size_t m = 0; m < n_; ++m) {
    int64_t sum = 0;
    for (const int64_t each : s) sum += *row++ * each;
    for (const int64_t each : pairs) sum += *row++ * each;
    if (std::abs(features[m] - round_shift(sum, kScaledFraction)) > tolerance_[m]) return false;
  }
  return true;
}

void FeatureWrench::forget() {
  last_us_ = 0;
  before_ = {};
  for (Term& t : terms_) t.state = {};
}

// Elastic force in, real force out.
void FeatureWrench::relax(Axes& e, uint64_t capture_us) {
  if (terms_.empty() || capture_us == 0) return;
  const uint64_t duration_us = last_us_ == 0 || capture_us <= last_us_ ? 0 : capture_us - last_us_;
  last_us_ = std::max(capture_us, last_us_);
  const Axes elastic = e;
  for (Term& t : terms_) {
    const int64_t step_q20 = relaxed_part_q20(duration_us, t.time_us);
    for (size_t i = 0; i < kAxes; ++i) {
      const int64_t mean = round_shift(elastic[i] + before_[i], 1);
      t.state[i] += part_of(mean - t.state[i], step_q20);
      e[i] -= part_of(t.state[i], t.part_q20[i]);
    }
  }
  before_ = elastic;
}

WrenchCovariance FeatureWrench::covariance_of(const Axes& u, int64_t outside_q8) const {
  int64_t square_q16 = 0;
  for (const int64_t each : u) square_q16 += each * each >> (2 * kScaledFraction - 16);
  const int64_t size_q8 = floor_sqrt(square_q16) + std::min(outside_q8, kMaxOutside);
  WrenchCovariance out;
  for (const Axes& v : error_[0]) add_outer(out, v);
  for (Axes v : error_[1]) {
    for (int64_t& each : v) each = round_shift(each * size_q8, 8);
    add_outer(out, v);
  }
  return out;
}

WrenchCovariance FeatureWrench::covariance_at_rest() const {
  WrenchCovariance out;
  for (size_t i = 0; i < kAxes; ++i) {
    Axes v{};
    v[i] = rest_.error()[i];
    add_outer(out, v);
  }
  return out;
}

FeatureWrench::Outcome FeatureWrench::run(std::span<const int32_t> features, const Warmth& warmth, uint64_t capture_us,
                                          SaturationCounter& saturations) {
  std::transform(features.begin(), features.end(), held_.begin(),
                 [](int32_t f) { return std::clamp(f, -kMaxFeature, kMaxFeature); });
  Axes e = linear(held_, saturations);
  const Axes u = scaled_q14(e);
  const auto pairs = products(u);
  for (size_t i = 0; i < kAxes; ++i) {
    int64_t sum = 0;
    for (size_t k = 0; k < kPairs; ++k) sum += square_[i * kPairs + k] * pairs[k];
    e[i] += round_shift(sum, kScaledFraction - square_shift_[i]);
  }
  const int64_t outside_q8 = kernel_.add(held_, e);
  for (int64_t& each : e) each = std::clamp(each, -kMaxForce, kMaxForce);
  Outcome out;
  const Axes strained = scaled_q14(e);
  out.is_in_agreement = agrees(features, strained);
  out.is_warmth_known = warmth_.correct(e, warmth);
  if (out.is_in_agreement) relax(e, capture_us);
  const bool is_untouched = rest_.is_untouched(held_);
  if (is_untouched) e = {};
  const int64_t limit = kernel_.is_loaded() ? kFitted : kInRange;
  out.is_in_range = outside_q8 == 0 && std::all_of(strained.begin(), strained.end(),
                                                   [&](int64_t each) { return std::abs(each) <= limit; });
  out.covariance = is_untouched ? covariance_at_rest() : covariance_of(scaled_q14(e), outside_q8);
  const auto force = [&](size_t i) { return measures(i) ? round_shift(e[i], kFine) : 0; };
  const auto torque = [&](size_t i) { return measures(i) ? round_shift(1'000 * e[i], kFine) : 0; };
  out.wrench = {force(0), force(1), force(2), torque(3), torque(4), torque(5)};
  return out;
}

}  // namespace ruffini
