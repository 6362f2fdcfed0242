#include "stages/feature_wrench/kernel_map.h"

#include <algorithm>
#include <cstdlib>
#include <limits>
#include <numeric>
#include <string>

#include "base/fixed.h"
#include "solve/node_sigma.h"

namespace ruffini {
namespace {

constexpr int kFine = 4;           // fraction bits of forces inside
constexpr int kLength = 20;        // of z and distances
constexpr int kStep = 14;          // of a distance, to steps of 1/64
constexpr int64_t kCurve = 1'025;  // entries
constexpr int64_t kMaxPlace = int64_t{1} << 26;
constexpr int32_t kMaxEntry = 1 << 26;
constexpr int32_t kMaxCurve = 1 << 24;
constexpr int32_t kMaxWeight = 1 << 28;
constexpr int32_t kMaxSpread = 1 << 16;
constexpr int kMaxShift = 40;
constexpr int64_t kMaxRowSum = int64_t{1} << 36;

// The sums stay inside 63 bits: squares of differences, w k.
static_assert(KernelMap::kMaxDirections <= std::numeric_limits<int64_t>::max() / ((2 * kMaxPlace) * (2 * kMaxPlace)));
static_assert(KernelMap::kMaxLandmarks * kMaxWeight * int64_t{kMaxCurve} <= int64_t{1} << 62);

bool are_within(std::span<const int32_t> values, int64_t limit) {
  return std::all_of(values.begin(), values.end(), [&](int64_t v) { return v >= -limit && v <= limit; });
}

bool are_shifts(std::span<const uint8_t> values) {
  return std::all_of(values.begin(), values.end(), [](uint8_t v) { return v >= 1 && v <= kMaxShift; });
}

Error refused(const std::string& what) {
  return {ErrorKind::kBadInput,
          "calibration file: wrench.kernel_" + what + ": make it again with cal fit --only wrench"};
}

}  // namespace

Result<KernelMap> KernelMap::load(const Calibration& c, int n_features) {
  KernelMap out;
  const Tensor* landmark = c.tensor("wrench.kernel_landmark");
  if (landmark == nullptr) return out;
  if (landmark->type != Tensor::Type::kI32 || landmark->shape.size() != 2 || landmark->shape[0] < 1 ||
      landmark->shape[0] > kMaxLandmarks || landmark->shape[1] < 1 || landmark->shape[1] > kMaxDirections) {
    return refused("landmark is no table of 1 to 1,024 places in 1 to 384 directions");
  }
  const int64_t m = landmark->shape[0];
  const int64_t d = landmark->shape[1];
  const auto project = c.tensor("wrench.kernel_project", Tensor::Type::kI32, {d, n_features});
  if (!project) return project.error();
  const auto weight = c.tensor("wrench.kernel_weight", Tensor::Type::kI32, {int64_t{kAxes}, m});
  if (!weight) return weight.error();
  const auto curve = c.tensor("wrench.kernel_curve", Tensor::Type::kI32, {kCurve});
  if (!curve) return curve.error();
  const auto offset = c.tensor("wrench.kernel_offset", Tensor::Type::kI32, {int64_t{kAxes}});
  if (!offset) return offset.error();
  const auto reach = c.tensor("wrench.kernel_reach", Tensor::Type::kI32, {2});
  if (!reach) return reach.error();
  const auto shift = c.tensor("wrench.kernel_shift", Tensor::Type::kU8, {int64_t{1 + kAxes}});
  if (!shift) return shift.error();
  const auto places = landmark->as<int32_t>();
  const auto p = project.value()->as<int32_t>();
  const auto w = weight.value()->as<int32_t>();
  const auto k = curve.value()->as<int32_t>();
  const auto o = offset.value()->as<int32_t>();
  const auto r = reach.value()->as<int32_t>();
  const auto s = shift.value()->as<uint8_t>();
  if (!are_within(places, kMaxPlace) || !are_within(p, kMaxEntry) || !are_within(w, kMaxWeight) ||
      !are_within(k, kMaxCurve) || !are_shifts(s) || r[0] < 0 || r[1] < 0 || r[1] > kMaxSpread) {
    return refused("*: a number is out of range");
  }
  out.n_ = static_cast<size_t>(n_features);
  for (size_t row = 0; row < static_cast<size_t>(d); ++row) {
    const auto entries = p.subspan(row * out.n_, out.n_);
    const int64_t sum = std::accumulate(entries.begin(), entries.end(), int64_t{0},
                                        [](int64_t a, int32_t v) { return a + std::abs(int64_t{v}); });
    if (sum > kMaxRowSum) return refused("project: a row sums to more than 2^36");
  }
  out.n_directions_ = static_cast<size_t>(d);
  out.n_landmarks_ = static_cast<size_t>(m);
  out.project_.assign(p.begin(), p.end());
  out.landmark_.assign(places.begin(), places.end());
  out.weight_.assign(w.begin(), w.end());
  out.curve_.assign(k.begin(), k.end());
  out.project_shift_ = s[0];
  std::copy(s.begin() + 1, s.end(), out.weight_shift_.begin());
  std::transform(o.begin(), o.end(), out.offset_.begin(), [](int32_t v) { return int64_t{v} << kFine; });
  out.reach_q20_ = r[0];
  out.spread_q8_ = r[1];
  out.z_.resize(out.n_directions_);
  return out;
}

void KernelMap::project(std::span<const int32_t> features) {
  for (size_t k = 0; k < n_directions_; ++k) {
    int64_t sum = 0;
    for (size_t m = 0; m < n_; ++m) sum += int64_t{project_[k * n_ + m]} * features[m];
    z_[k] = std::clamp(round_shift(sum, project_shift_), -kMaxPlace, kMaxPlace);
  }
}

int64_t KernelMap::kernel_q24(int64_t distance_q20) const {
  const int64_t held = std::min<int64_t>(distance_q20, (kCurve - 1) << kStep);
  const auto i = static_cast<size_t>(std::min<int64_t>(held >> kStep, kCurve - 2));
  const int64_t part = held - (static_cast<int64_t>(i) << kStep);
  return round_shift(curve_[i] * ((int64_t{1} << kStep) - part) + curve_[i + 1] * part, kStep);
}

int64_t KernelMap::add(std::span<const int32_t> features, Axes& e) {
  if (!is_loaded()) return 0;
  project(features);
  Axes sum{};
  int64_t nearest_q20 = std::numeric_limits<int64_t>::max();
  for (size_t j = 0; j < n_landmarks_; ++j) {
    int64_t square = 0;
    const int32_t* place = landmark_.data() + j * n_directions_;
    for (size_t k = 0; k < n_directions_; ++k) {
      const int64_t off = z_[k] - place[k];
      square += off * off;
    }
    const int64_t distance_q20 = floor_sqrt(square);
    nearest_q20 = std::min(nearest_q20, distance_q20);
    const int64_t value = kernel_q24(distance_q20);
    for (size_t i = 0; i < kAxes; ++i) sum[i] += weight_[i * n_landmarks_ + j] * value;
  }
  for (size_t i = 0; i < kAxes; ++i) e[i] += offset_[i] + round_shift(sum[i], weight_shift_[i]);
  const int64_t excess_q20 = std::max<int64_t>(nearest_q20 - reach_q20_, 0);
  return excess_q20 == 0 ? 0 : 1 + (excess_q20 * spread_q8_ >> kLength);
}

}  // namespace ruffini
