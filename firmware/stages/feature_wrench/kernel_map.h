// Nonlinear part of a wrench from image features: a kernel of the distance to landmarks of the log.
//
//   z   = P f                          d x n, in lengths of the kernel, Q20, within +-64
//   D_j = |z - c_j|                    to landmark j
//   y_i = o_i + sum_j w_ij k(D_j)      k: table of 64 steps a length to 16 lengths, linear between, its last entry
//                                      beyond
//
// Added to K f, with which it is fitted together (host/ruffini/estimators/wrench/kernel.py). Further from every
// landmark than `reach` the map was not fitted: the frame is out of range, and the covariance grows with the excess.
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

class KernelMap {
 public:
  static constexpr size_t kAxes = 6;
  static constexpr int64_t kMaxDirections = 384;
  static constexpr int64_t kMaxLandmarks = 1'024;
  using Axes = std::array<int64_t, kAxes>;

  // Tensors wrench.kernel_*; none of them: nothing is added. Errors: kBadInput.
  [[nodiscard]] static Result<KernelMap> load(const Calibration& calibration, int n_features);

  // Adds to e, 1/16 uN and uN mm. Returns by how much the nearest landmark is beyond the reach, as a part of the full
  // scale, Q8; 0 inside. Features within FeatureWrench::kMaxFeature.
  [[nodiscard]] int64_t add(std::span<const int32_t> features, Axes& e);

  [[nodiscard]] bool is_loaded() const { return !landmark_.empty(); }

 private:
  void project(std::span<const int32_t> features);
  [[nodiscard]] int64_t kernel_q24(int64_t distance_q20) const;

  size_t n_ = 0;
  size_t n_directions_ = 0;
  size_t n_landmarks_ = 0;
  std::vector<int32_t> project_;   // P, [d][n]
  std::vector<int32_t> landmark_;  // c, [m][d], Q20
  std::vector<int32_t> weight_;    // w, [6][m]
  std::vector<int32_t> curve_;     // k, Q24
  int project_shift_ = 1;
  std::array<int, kAxes> weight_shift_{};
  Axes offset_{};  // o, 1/16 uN and uN mm
  int64_t reach_q20_ = 0;
  int64_t spread_q8_ = 0;  // parts of the full scale a length
  std::vector<int64_t> z_;
};

}  // namespace ruffini
