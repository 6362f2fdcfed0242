// Small integer network: principal components, two hidden layers of rectified units; outputs means and log2 of
// deviations.
//
//   z = W_0 (f - mean)                     also decides whether such features were in the training data:
//   |z|^2 weighted by `near` <= limit, and residual of f - mean after z at most `rest` per feature (mean square)
//   h_1 = max(W_1 z + b_1, 0), h_2 = max(W_2 h_1 + b_2, 0), out = W_3 h_2 + b_3
//
// Values and weights Q16, W_0 Q28 per 1/16 um. One set of tables for each combination of eyes (`Eyes`). Frame thread;
// no allocation after load().
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

class TipNet {
 public:
  static constexpr size_t kLayers = 3;
  static constexpr int64_t kMaxWidth = 512;

  // Loads set `mode` of `n_modes` of the tables fingertip.*. Errors: kBadInput.
  [[nodiscard]] static Result<TipNet> load(const Calibration& calibration, size_t mode, size_t n_modes,
                                           size_t n_features, size_t n_outputs);

  // Precondition: `features` has as many values as given to load().
  std::span<const int64_t> run(std::span<const int32_t> features, SaturationCounter& saturations);
  // True if the last features resemble those of the fit.
  [[nodiscard]] bool is_known() const { return is_known_; }

 private:
  struct Layer {
    size_t n_in = 0;
    std::vector<int32_t> weight;  // [n_out][n_in]
    std::vector<int32_t> bias;
  };
  void judge(int64_t square);

  std::vector<int32_t> mean_;
  Layer first_;
  std::array<Layer, kLayers> layer_;
  std::vector<int32_t> near_;    // Q12
  std::vector<int32_t> length_;  // of f per unit of z, 1/16 um
  int64_t limit_ = 0;
  int64_t rest_ = 0;  // 1/16 um
  std::vector<int64_t> centred_, z_, in_, out_;
  bool is_known_ = false;
};

}  // namespace ruffini
