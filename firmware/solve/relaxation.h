// The pad's memory: rubber under a held strain loses 20 to 30 % of its force over seconds.
//
// The inverse FEM gives the elastic force f_e that the measured displacement would need at once. With
// the relaxation function 1 - sum g_k (1 - exp(-t / tau_k)) (Prony series, one for the whole pad) the force is
//
//   f = f_e - sum g_k h_k,   tau_k dh_k/dt = f_e - h_k
//
// for every node and axis by itself, because one relaxation function multiplies the whole stiffness. Over
// a step of the time between two captures, f_e its mean over the step:
//
//   h += (1 - exp(-dt / tau)) ((f_e + f_e,before) / 2 - h)
//
// Outside the contact f = 0: there f_e = sum g_k h_k, the dent that has not yet come back. What that dent does to
// the neighbours' f_e is left out. Formats: h in 1/65536 force step, f_e held to 2^25 steps (counted), g and
// 1 - exp in Q20, so that every product fits 63 bits. `relaxation` kind of the calibration, fitted by
// `ruffini cal fit --only relaxation`. Not in the paper.
// Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "solve/contact_mask.h"
#include "store/calibration.h"

namespace ruffini {

// 1 - exp(-duration / time), Q20, within one step; both in microseconds, time > 0.
[[nodiscard]] int64_t relaxed_part_q20(uint64_t duration_us, int64_t time_us);

class Relaxation {
 public:
  static constexpr int kMaxTerms = 4;
  static constexpr int kFraction = 16;

  [[nodiscard]] static Result<Relaxation> load(const Calibration& calibration, int n_nodes);

  // `force`: elastic in, real out. `mask`: ContactMask's. A capture not later than the one before takes no time.
  void run(uint64_t capture_us, std::span<const uint8_t> mask, std::span<NodeForce> force,
           SaturationCounter& saturations);
  // Nothing ever touched the pad.
  void forget();

 private:
  struct Term {
    int64_t part_q20 = 0;
    int64_t time_us = 1;
    int64_t step_q20 = 0;                       // relaxed part of this frame's step
    std::vector<std::array<int64_t, 3>> state;  // h of each node
  };

  // One axis of one node: elastic force in, real out, both in force steps.
  int64_t step(size_t node, size_t axis, bool is_touched, int64_t force, SaturationCounter& saturations);

  std::vector<Term> terms_;
  std::vector<std::array<int64_t, 3>> before_;  // elastic force of the frame before, as h
  uint64_t last_us_ = 0;
};

}  // namespace ruffini
