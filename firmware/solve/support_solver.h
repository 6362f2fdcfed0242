// Second pass: weighted least squares on the contact's support, with the pressure constrained to push.
//
// Solves H_SS y = b_S, F = d y (derivation: host/ruffini/fem/support.py), starting from the linear estimate, in kRounds
// rounds of kSteps conjugate-gradient steps. Each unknown has a weight w: the contact mask at first and, in each later
// round, that times clamp(-f_z / T, 0, 1) with T the threshold of the contact mask, so that nodes that would pull lose
// their force and their freedom. Shear has half the freedom of pressure, except along the shear modes (shear_modes.h),
// which are recomputed every round. In block-floating integers:
//
//   w          Q7
//   y, r       Q14, clamped to +-2^31, counted
//   z = M r    M = w^2 (a quarter of it for shear) + modes; r . z = v . v + the modes' part, v = w r (w r / 2)
//   p16        p rounded to 16 bits with one common shift (as v16 for the energies)
//   H p16      `support.normal`, 8 more fraction bits, clamped to +-2^33, counted
//   s          y . b / (y . H y), Q12, clamped to 1/4..4: the first round starts from s y instead of y, at no extra
//              product. It restores the amplitude that the linear estimate attributes to the unknown constant of depth:
//              half of a wide punch
//   b          `support.project` u, plus H times the finite-strain part, as y
//   step, beta mantissa of 24 bits and a power of two
//   F = (y d + 2^29) >> 30, d = `support.scale` (Q16 force steps per unit of y)
//
// Cost: at most kRounds (kSteps + 1) products with the rows and columns of S, and one with all columns. Frame thread;
// no allocation after the constructor.
//
// residual() computes the unexplained part at all nodes: r = b - H (y - beyond / d). With u = C F + e and e of
// covariance R, r is D C^T R^-1 e, and H has a unit diagonal: under any load r_j has standard deviation one if the pad,
// the contact and the noise match the calibration. r is the matched filter for one more force along unknown j: r_j d_j
// is the force that best explains the residual there, and d_j is its standard deviation.
// watch() selects a few unknowns whose r is computed in every frame from the rounds' own b - H y, by adding their rows
// to each product. It differs from residual() only by rounding. Not in the paper.
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
  static constexpr int kResidualFraction = 6;  // of residual()

  [[nodiscard]] static Result<SupportSolver> load(const Calibration& calibration, GridSize nodes,
                                                  std::span<const NodePlace> places);

  // `u`: displacement, xyz interleaved. `mask`, `threshold_lsb`: from ContactMask. `force`: linear estimate in, second
  // pass out (zero outside the mask). `beyond`: finite-strain part that `force` already contains (finite_strain.h), or
  // empty.
  void run(std::span<const int16_t> u, std::span<const NodeForce> beyond, std::span<const uint8_t> mask,
           int64_t threshold_lsb, std::span<NodeForce> force, SaturationCounter& saturations);

  // `project` u of the last run(), x, y, z of each node of its mask in node order, Q14.
  [[nodiscard]] std::span<const int64_t> evidence() const { return evidence_; }

  // Selects the unknowns whose r run() computes; each at most once. Allocates.
  void watch(std::span<const uint32_t> unknowns);
  // Writes r of the last run(), in the order of watch(), in 1/64 standard deviation.
  void watched_residual(std::span<int32_t> residual) const;
  // Writes r of every unknown for the last run() and its `u`, in 1/64 standard deviation. Costs two products with all
  // rows.
  void residual(std::span<const int16_t> u, std::span<int32_t> residual, SaturationCounter& saturations);

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
  // Scatters `values` (one per unknown of the support) to p16_. Returns the shift.
  int spread(std::span<const int64_t> values);
  void multiply(SaturationCounter& saturations);

  BlockProgram normal_;
  BlockProgram project_;
  std::span<const int32_t> scale_;
  ShearModes modes_;
  std::vector<uint32_t> all_;       // unknowns
  std::vector<uint32_t> index_;     // unknowns of the support
  std::vector<uint32_t> selected_;  // unknowns of the support, and watched unknowns outside it
  std::vector<int16_t> p16_;        // all unknowns
  std::vector<int64_t> wide_;       // all unknowns of a product
  bool has_beyond_ = false;
  std::vector<int64_t> beyond_;    // all unknowns
  std::vector<int64_t> residual_;  // all unknowns
  std::vector<int64_t> weight_;
  std::vector<int64_t> b_;
  std::vector<int64_t> evidence_;  // b without the finite-strain part
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
  SaturationCounter watched_saturations_;  // separate, because they do not affect the forces
};

}  // namespace ruffini
