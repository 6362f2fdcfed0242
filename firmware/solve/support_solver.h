// Second pass: least squares on the contact's support, by a fixed number of conjugate-gradient steps.
//
// Solves H_SS y = b_S, F = d y (host/ruffini/fem/support.py has the derivation), warm-started from the
// linear estimate, in block-floating integers:
//
//   y, r, p    Q14, clamped to +-2^31, counted
//   p16        p rounded to 16 bits with one common shift (as r16 for the energies)
//   H p16      `support.normal`, 8 more fraction bits, clamped to +-2^33, counted;  b = `support.project` u
//   step, beta mantissa of 24 bits and a power of two
//   F = (y d + 2^29) >> 30, d = `support.scale` (Q16 force steps per unit of y)
//
// Work is bounded by kSteps |S| rows. Frame thread; no allocation after the constructor. Not in the paper.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "solve/block_operator.h"
#include "solve/contact_mask.h"

namespace ruffini {

class SupportSolver {
 public:
  static constexpr int kSteps = 6;

  [[nodiscard]] static Result<SupportSolver> load(const Calibration& calibration, int n_nodes);

  // `u`: padded displacement, xyz interleaved. `force`: linear estimate in, second pass out (zero
  // outside the mask).
  void run(std::span<const int16_t> u, std::span<const uint8_t> mask, std::span<NodeForce> force,
           SaturationCounter& saturations);

 private:
  // Mantissa below 2^24 and exponent of a positive ratio.
  struct Scale {
    int64_t mantissa = 0;
    int exponent = 0;
  };
  struct Energy {
    int64_t sum = 0;  // of squares of r16
    int shift = 0;    // r16 = r >> shift
  };

  static Scale ratio(int64_t numerator, int64_t denominator, int exponent);
  static int64_t scaled(int64_t value, const Scale& scale, int exponent);
  [[nodiscard]] Energy energy() const;
  void gather(std::span<const uint8_t> mask);
  void start(std::span<const int16_t> u, std::span<const NodeForce> force, SaturationCounter& saturations);
  bool step(Energy& current, SaturationCounter& saturations);
  // Spread `values` (one per unknown of the support) to p16_; returns the shift.
  int spread(std::span<const int64_t> values);
  void multiply(SaturationCounter& saturations);

  BlockOperator normal_;
  BlockOperator project_;
  std::span<const int32_t> scale_;
  std::vector<uint32_t> index_;   // unknowns of the support
  std::vector<uint16_t> blocks_;  // column blocks that hold one
  std::vector<int16_t> p16_;      // all unknowns, padded
  std::vector<int64_t> y_;
  std::vector<int64_t> r_;
  std::vector<int64_t> p_;
  std::vector<int64_t> image_;  // H p16
};

}  // namespace ruffini
