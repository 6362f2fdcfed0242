// Perceptron with one hidden layer of tanh units, in integers.
//
//   a_j = (sum_i w_ji x_i + w_j 2^14) / 2^s     Q12;  x: Q14, or any integers that it was fitted on
//   h_j = tanh a_j                              Q15; the calibration's table in steps of 1/64 to 8, linear between, odd
//   y_k = (sum_j v_kj h_j + v_k 2^15) / 2^t     in the unit of the fit
//
// Tensors <name>_hidden I32 [n_hidden, n_in + 1], <name>_out I32 [n_out, n_hidden + 1] and <name>_shift U8 [2] = s, t;
// the last columns hold w_j and v_k. The kind of the calibration has its own `tanh` table. No allocation after load.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "base/fixed.h"
#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

class TanhTable {
 public:
  static constexpr int kStepsPerUnit = 64;
  static constexpr int kSize = 8 * kStepsPerUnit + 1;

  // Returns kBadInput if the table does not rise monotonically from 0 to at most 1.
  [[nodiscard]] static Result<TanhTable> load(const Calibration& calibration, const std::string& name);
  [[nodiscard]] int64_t tanh_q15(int64_t a_q12) const;

 private:
  std::vector<int16_t> table_;
};

class Perceptron {
 public:
  static constexpr int64_t kMaxHidden = 64;
  static constexpr int64_t kMaxInput = 1 << 20;

  [[nodiscard]] static Result<Perceptron> load(const Calibration& calibration, const std::string& name, int n_inputs,
                                               int n_outputs);

  // Inputs must lie within kMaxInput. If one does not, every output is 0 and a saturation is counted.
  void run(const TanhTable& tanh, std::span<const int64_t> inputs, std::span<int64_t> outputs,
           SaturationCounter& saturations);

 private:
  size_t n_inputs_ = 0;
  std::vector<int32_t> hidden_;
  std::vector<int32_t> out_;
  int hidden_shift_ = 1;
  int out_shift_ = 1;
  std::vector<int64_t> unit_;  // h
};

}  // namespace ruffini
