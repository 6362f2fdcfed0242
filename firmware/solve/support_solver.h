// Second pass: weighted least squares on the contact's support, pressure pushed to its right sign.
//
// Solves H_SS y = b_S, F = d y (host/ruffini/fem/support.py has the derivation), from the linear
// estimate, in kRounds rounds of kSteps conjugate-gradient steps. Each unknown has a weight w: the
// contact mask at first, and in each later round times clamp(-f_z / T, 0, 1), T the contact mask's threshold, so
// that nodes which would pull lose their force and their freedom. Shear has half the freedom of pressure,
// but for the modes that contacts mostly carry (shear_modes.h), renewed every round. In block-floating integers:
//
//   w          Q7
//   y, r       Q14, clamped to +-2^31, counted
//   z = M r    M = w^2 (a quarter of it for shear) + modes; r . z = v . v + the modes' part, v = w r (w r / 2)
//   p16        p rounded to 16 bits with one common shift (as v16 for the energies)
//   H p16      `support.normal`, 8 more fraction bits, clamped to +-2^33, counted
//   s          y . b / (y . H y), Q12, clamped to 1/4..4: the first round begins with s y in place of y, which costs no product.
//              What the linear estimate takes for the depth's free constant it lacks in size: half of a wide punch
//   b          `support.project` u, and H of what finite strain adds, as y
//   step, beta mantissa of 24 bits and a power of two
//   F = (y d + 2^29) >> 30, d = `support.scale` (Q16 force steps per unit of y)
//
// Work is bounded by kRounds (kSteps + 1) products with the rows and columns of S, one with
// all columns. Frame thread; no allocation after the constructor.
//
// leave() says what these forces do not explain, at all nodes: r = b - H (y - beyond / d). With u = C F + e, e of
// covariance R, r is D C^T R^-1 e, and H has a unit diagonal: r_j is of standard deviation one where the pad, the contact
// and the noise are as the calibration takes them, whatever presses. It is the matched filter of one more force along
// unknown j: r_j d_j is the force that best explains what is left there, d_j the standard deviation of that force.
// watch() selects a few unknowns whose r is computed in every frame from the rounds' own b - H y, with their rows added to
// each product. It differs from leave()'s r only by the rounding of the steps.
// Not in the paper.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "base/fixed.h"
#include "solve/block_program.h"
#include "solve/contact_mask.h"
#include "solve/shear_modes.h"

namespace ruffini {

class SupportSolver {
 public:
  static constexpr int kRounds = 3;
  static constexpr int kSteps = 2;
  static constexpr int kLeftFraction = 6;  // of what leave() says

  [[nodiscard]] static Result<SupportSolver> load(const Calibration& calibration, GridSize nodes,
                                                  std::span<const NodePlace> places);

  // `u`: displacement, xyz interleaved. `mask`, `threshold_lsb`: ContactMask's. `force`: linear estimate in,
  // second pass out (zero outside the mask). `beyond`: what finite strain adds to the linear forces of u
  // (finite_strain.h), in `force` already; empty without.
  void run(std::span<const int16_t> u, std::span<const NodeForce> beyond, std::span<const uint8_t> mask,
           int64_t threshold_lsb, std::span<NodeForce> force, SaturationCounter& saturations);

  // Selects the unknowns whose r run() computes; each at most once. Allocates.
  void watch(std::span<const uint32_t> unknowns);
  // Writes r of the last run(), in the order of watch(), in 1/64 standard deviation.
  void leave_watched(std::span<int32_t> residual) const;
  // Of the last run() and its `u`: r of every unknown, in 1/64 standard deviation. Two products with all rows.
  void leave(std::span<const int16_t> u, std::span<int32_t> residual, SaturationCounter& saturations);

 private:
  struct Energy {
    int64_t sum = 0;  // of squares of v16
    int shift = 0;    // v16 = v >> shift
  };

  explicit SupportSolver(ShearModes modes) : modes_(std::move(modes)) {}

  void gather(std::span<const uint8_t> mask);
  void start(std::span<const int16_t> u, std::span<const NodeForce> force, SaturationCounter& saturations);
  void add_to_b(std::span<const NodeForce> beyond, SaturationCounter& saturations);
  void weaken_pull(int64_t threshold_lsb);
  [[nodiscard]] int64_t size_q12(int shift) const;
  void round(bool is_first, SaturationCounter& saturations);
  bool step(Energy& current, SaturationCounter& saturations);
  Energy precondition();
  // Spread `values` (one per unknown of the support) to p16_; returns the shift.
  int spread(std::span<const int64_t> values);
  void multiply(SaturationCounter& saturations);

  BlockProgram normal_;
  BlockProgram project_;
  std::span<const int32_t> scale_;
  ShearModes modes_;
  std::vector<uint32_t> all_;       // unknowns
  std::vector<uint32_t> index_;     // unknowns of the support
  std::vector<uint32_t> selected_;  // unknowns of the support, and of those watched that are none
  std::vector<int16_t> p16_;        // all unknowns
  std::vector<int64_t> wide_;       // all unknowns of a product
  bool has_beyond_ = false;
  std::vector<int64_t> beyond_;  // all unknowns
  std::vector<int64_t> left_;    // all unknowns
  std::vector<int64_t> weight_;
  std::vector<int64_t> b_;
  std::vector<int64_t> y_;
  std::vector<int64_t> r_;
  std::vector<int64_t> v_;
  std::vector<int64_t> z_;
  std::vector<int64_t> p_;
  std::vector<int64_t> image_;  // H p16
  struct Watched {
    uint32_t unknown = 0;
    int64_t b = 0;
    int64_t r = 0;
    int64_t image = 0;
  };
  std::vector<Watched> watched_;
  SaturationCounter watched_saturations_;  // its own: the forces are none the worse
};

}  // namespace ruffini
