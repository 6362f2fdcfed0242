// Viscoelastic relaxation of the pad: rubber under constant strain loses 20 to 30 % of its force within seconds.
//
// The inverse FEM gives the elastic force f_e, which the measured displacement would require instantaneously. With the
// relaxation function 1 - sum g_k (1 - exp(-t / tau_k)) (Prony series, one for the whole pad) the force is
//
//   f = f_e - sum g_k h_k,   tau_k dh_k/dt = f_e - h_k
//
// for every node and axis separately, because one relaxation function scales the whole stiffness. Over the interval
// between two captures, with f_e taken as its mean over the interval:
//
//   h += (1 - exp(-dt / tau)) ((f_e + f_e,before) / 2 - h)
//
// Outside the contact f = 0, so f_e = sum g_k h_k: the dent that has not yet recovered. The influence of that dent on
// the neighbours' f_e is neglected. Formats: h in 1/65536 force step; f_e clamped to 2^25 steps, counted; g and 1 - exp
// in Q20, so that every product fits 63 bits. Kind `relaxation` of the calibration, fitted by `ruffini cal fit --only
// relaxation`. Not in the paper. Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "solve/contact_mask.h"
#include "store/calibration.h"

namespace ruffini {

// Returns 1 - exp(-duration / time) in Q20, accurate to one step. Precondition: time > 0. Both in microseconds.
[[nodiscard]] int64_t relaxed_part_q20(uint64_t duration_us, int64_t time_us);

class Relaxation {
 public:
  static constexpr int kMaxTerms = 4;
  static constexpr int kFraction = 16;

  [[nodiscard]] static Result<Relaxation> load(const Calibration& calibration, int n_nodes);

  // Replaces the elastic `force` by the relaxed one. `mask`: from ContactMask. A capture that is not later than the
  // previous one counts as zero elapsed time.
  void run(uint64_t capture_us, std::span<const uint8_t> mask, std::span<NodeForce> force,
           SaturationCounter& saturations);
  // Resets the history to a pad that was never touched.
  void forget();

 private:
  struct Term {
    int64_t part_q20 = 0;
    int64_t time_us = 1;
    int64_t step_q20 = 0;                       // 1 - exp for this frame's interval
    std::vector<std::array<int64_t, 3>> state;  // h of each node
  };

  // One axis of one node: takes the elastic force and returns the relaxed one, both in force steps.
  int64_t step(size_t node, size_t axis, bool is_touched, int64_t force, SaturationCounter& saturations);

  std::vector<Term> terms_;
  std::vector<std::array<int64_t, 3>> before_;  // elastic force of the previous frame, in the format of h
  uint64_t last_us_ = 0;
};

}  // namespace ruffini
