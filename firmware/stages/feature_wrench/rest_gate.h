// Decides whether a picture's features are those of an untouched gel, which vary by noise and by light that drifts.
//
//   untouched: |R f| <= 1      R: d x n, Q20; R^T R = (inverse covariance of untouched features) / limit^2, the limit
//                              as the fit sets it (host/ruffini/estimators/wrench/rest.py)
//
// Not in the paper. Frame thread; no allocation after load.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

class RestGate {
 public:
  static constexpr size_t kAxes = 6;
  static constexpr int64_t kMaxDirections = 384;
  using Axes = std::array<int64_t, kAxes>;

  // Tensors wrench.rest_*; none of them: nothing counts as untouched. Errors: kBadInput.
  [[nodiscard]] static Result<RestGate> load(const Calibration& calibration, int n_features);

  // Features within FeatureWrench::kMaxFeature.
  [[nodiscard]] bool is_untouched(std::span<const int32_t> features) const;

  // Standard deviation of each axis on a frame that counts as untouched, uN and uN mm.
  [[nodiscard]] const Axes& error() const { return error_; }

 private:
  size_t n_ = 0;
  std::vector<int32_t> project_;  // R, [d][n]
  int shift_ = 1;
  Axes error_{};
};

}  // namespace ruffini
