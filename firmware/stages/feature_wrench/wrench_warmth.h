// What temperature does to a wrench of features: rubber gets stiffer or softer, and a housing that grows moves the
// features although nothing presses.
//
//   e_i <- (e_i - o_i (T - T_rest)) (1 + g_i (T - T_ref))
//
// T_ref: of the calibration; T_rest: when rest was learned, T_ref where that is unknown (a rest picture that came with
// the calibration). Differences are held within +-100 K. Not in the paper. Frame thread.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "base/result.h"
#include "core/results.h"
#include "store/calibration.h"

namespace ruffini {

class WrenchWarmth {
 public:
  static constexpr size_t kAxes = 6;
  using Axes = std::array<int64_t, kAxes>;

  // Tensors wrench.warm_*; none of them: nothing to correct. Errors: kBadInput.
  [[nodiscard]] static Result<WrenchWarmth> load(const Calibration& calibration);

  // In 1/16 uN and uN mm, |e| below 2^38. Returns false, and leaves e, where the calibration corrects and the
  // temperature is unknown, or further than 10 K outside of what the calibration saw.
  [[nodiscard]] bool correct(Axes& e, const Warmth& warmth) const;

 private:
  bool is_loaded_ = false;
  int64_t reference_mc_ = 0;
  int64_t coldest_mc_ = 0;
  int64_t warmest_mc_ = 0;
  Axes gain_q30_{};    // a mK
  Axes offset_q10_{};  // 1/16 uN or uN mm a mK
};

}  // namespace ruffini
