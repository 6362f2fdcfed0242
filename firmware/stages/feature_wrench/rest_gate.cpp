#include "stages/feature_wrench/rest_gate.h"

#include <algorithm>
#include <cstdlib>
#include <limits>
#include <numeric>
#include <string>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int kLength = 20;
constexpr int64_t kLimit = int64_t{1} << (2 * kLength);  // of |R f|^2
constexpr int64_t kMaxPlace = int64_t{1} << 26;
constexpr int64_t kMaxEntry = 1 << 26;
constexpr int64_t kMaxSigma = 1 << 25;
constexpr int64_t kMaxRowSum = int64_t{1} << 36;
constexpr int kMaxShift = 40;

static_assert(RestGate::kMaxDirections <= std::numeric_limits<int64_t>::max() / (kMaxPlace * kMaxPlace));

Error refused(const std::string& what) {
  return {ErrorKind::kBadInput, "calibration file: wrench.rest_" + what + ": make it again with cal fit --only wrench"};
}

}  // namespace

Result<RestGate> RestGate::load(const Calibration& c, int n_features) {
  RestGate out;
  const Tensor* project = c.tensor("wrench.rest_project");
  if (project == nullptr) return out;
  if (project->type != Tensor::Type::kI32 || project->shape.size() != 2 || project->shape[0] < 1 ||
      project->shape[0] > kMaxDirections || project->shape[1] != n_features) {
    return refused("project is no table of 1 to 384 directions of the features");
  }
  const auto shift = c.tensor("wrench.rest_shift", Tensor::Type::kU8, {1});
  if (!shift) return shift.error();
  const auto error = c.tensor("wrench.rest_error", Tensor::Type::kI32, {int64_t{kAxes}});
  if (!error) return error.error();
  const auto p = project->as<int32_t>();
  const auto e = error.value()->as<int32_t>();
  out.shift_ = shift.value()->as<uint8_t>()[0];
  if (out.shift_ < 1 || out.shift_ > kMaxShift ||
      std::any_of(p.begin(), p.end(), [](int64_t v) { return std::abs(v) > kMaxEntry; }) ||
      std::any_of(e.begin(), e.end(), [](int64_t v) { return v < 0 || v > kMaxSigma; })) {
    return refused("*: a number is out of range");
  }
  out.n_ = static_cast<size_t>(n_features);
  for (size_t row = 0; row < p.size() / out.n_; ++row) {
    const auto entries = p.subspan(row * out.n_, out.n_);
    const int64_t sum = std::accumulate(entries.begin(), entries.end(), int64_t{0},
                                        [](int64_t a, int32_t v) { return a + std::abs(int64_t{v}); });
    if (sum > kMaxRowSum) return refused("project: a row sums to more than 2^36");
  }
  out.project_.assign(p.begin(), p.end());
  std::copy(e.begin(), e.end(), out.error_.begin());
  return out;
}

bool RestGate::is_untouched(std::span<const int32_t> features) const {
  if (project_.empty()) return false;
  int64_t square = 0;
  for (auto row = project_.begin(); row != project_.end(); row += static_cast<std::ptrdiff_t>(n_)) {
    int64_t sum = 0;
    for (size_t m = 0; m < n_; ++m) sum += int64_t{row[static_cast<std::ptrdiff_t>(m)]} * features[m];
    const int64_t z = std::clamp(round_shift(sum, shift_), -kMaxPlace, kMaxPlace);
    square += z * z;
    if (square > kLimit) return false;
  }
  return true;
}

}  // namespace ruffini
