// Wrench of a vector of image features f (changes against rest): F-TOUCH eq. 2 and what goes beyond it.
//
//   linear       y = K f                                      6 x n, per axis a shift; the paper's K
//   quadratic    e_i = y_i + sum_{j <= k} q_ijk u_j u_k       u = y / full scale, Q14, within +-2
//   kernel       e_i += o_i + sum_j w_ij k(|P f - c_j|)       terms not linear in the features: kernel_map.h
//   temperature  e_i as of the calibration's temperature      wrench_warmth.h
//   relaxation   w_i = e_i - sum_t g_ti h_ti,  tau_t dh_ti/dt = e_i - h_ti     loss of a held load (solve/relaxation.h)
//   untouched    w_i = 0                                      features as at rest: rest_gate.h
//   agreement    |f_m - (G s + H s s)_m| <= tolerance_m       s: as u, of e; G, H: features of a wrench. Beyond it the
//                                                             features contradict each other: some are wrong
//   covariance   sum v v^T of 6 constant vectors, and of 6 vectors that grow with |s| and with the distance from the
//                fitted features: positive semi-definite in integers
//
// y and e in 1/16 uN and uN mm. Any features: the table states their sort (core/stages.cpp), their number and
// the axes that it was fitted on. Only K is from the paper. Frame thread; no allocation after load.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "base/fixed.h"
#include "base/result.h"
#include "estimators/wrench.h"
#include "estimators/wrench_covariance.h"
#include "stages/feature_wrench/kernel_map.h"
#include "stages/feature_wrench/rest_gate.h"
#include "stages/feature_wrench/wrench_warmth.h"
#include "store/calibration.h"

namespace ruffini {

class FeatureWrench {
 public:
  static constexpr int kAxes = 6;
  static constexpr int kPairs = 21;           // of axes, j <= k, by rows
  static constexpr int kMaxFeatures = 8'192;  // two of 64 x 64 markers
  static constexpr int kMaxTerms = 4;
  static constexpr int32_t kMaxFeature = 1 << 26;  // 1,024 px in Q16

  struct Outcome {
    Wrench wrench;
    WrenchCovariance covariance;
    bool is_in_agreement = false;
    bool is_in_range = false;     // |s| <= 5/4 on every measured axis; with a kernel <= 1, and near a landmark
    bool is_warmth_known = true;  // or the calibration does not correct for it
  };

  // Kind "wrench" of the calibration, for features of this sort. Errors: kBadInput; kRefused where it is for others.
  [[nodiscard]] static Result<FeatureWrench> load(const Calibration& calibration, std::string_view features,
                                                  int n_features);

  // `features` as many as at load. A capture not later than the one before takes no time; 0: without relaxation.
  [[nodiscard]] Outcome run(std::span<const int32_t> features, const Warmth& warmth, uint64_t capture_us,
                            SaturationCounter& saturations);
  // Nothing was ever loaded.
  void forget();
  // Force that the linear part alone makes of features; no torque. For what does not come from a load.
  [[nodiscard]] Wrench linear_part(std::span<const int32_t> features) const;

  [[nodiscard]] bool measures(size_t axis) const { return full_scale_[axis] > 0; }

 private:
  using Axes = std::array<int64_t, kAxes>;
  struct Term {
    int64_t time_us = 1;
    Axes part_q20{};
    Axes state{};  // h
  };

  [[nodiscard]] Status load_square_shift(const Calibration& calibration);
  [[nodiscard]] Status load_agreement(const Calibration& calibration);
  [[nodiscard]] Status load_relaxation(const Calibration& calibration);
  [[nodiscard]] Axes linear(std::span<const int32_t> features, SaturationCounter& saturations) const;
  [[nodiscard]] Axes scaled_q14(const Axes& y) const;
  [[nodiscard]] bool agrees(std::span<const int32_t> features, const Axes& s) const;
  void relax(Axes& e, uint64_t capture_us);
  [[nodiscard]] WrenchCovariance covariance_of(const Axes& u, int64_t outside_q8) const;
  [[nodiscard]] WrenchCovariance covariance_at_rest() const;

  size_t n_ = 0;
  std::vector<int32_t> gain_;       // K, [6][n]
  std::array<int, kAxes> shift_{};  // of the sums
  Axes full_scale_{};               // 1/16 uN and uN mm; 0: not measured
  std::vector<int32_t> square_;     // q, [6][21], 1/16 uN and uN mm, shifted left by square_shift_
  std::array<int, kAxes> square_shift_{};
  std::vector<int32_t> forward_;                    // G and H, [n][6 + 21]; empty: agreement is not looked at
  std::vector<int32_t> tolerance_;                  // [n]
  std::array<std::array<Axes, kAxes>, 2> error_{};  // constant, at |u| = 1; uN, uN mm
  KernelMap kernel_;
  RestGate rest_;
  std::vector<int32_t> held_;  // features within kMaxFeature
  WrenchWarmth warmth_;
  std::vector<Term> terms_;
  Axes before_{};
  uint64_t last_us_ = 0;
};

}  // namespace ruffini
