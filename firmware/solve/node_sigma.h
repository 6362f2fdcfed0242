// Standard deviation of each nodal force of the second pass, read off the field itself
// (host/ruffini/fem/uncertainty.py has the model and its reasons; proto/CALIBRATION.md the tables).
//
//   variance_c = table_c[level] + (reading_c + s^2) f_c^2 + step_c m_c^2 + w (contrast_c d_c^2 + rough_c r^2)
//
//   level      bit width of |f_z|; of a node without f_z, from the largest |f_z| of its eight neighbours
//   d          f_c less the mean of the eight neighbours, in 1/8 steps; beyond the grid there is no force
//   m          largest difference from one of them
//   r^2        sum of d_z^2 over the 7 x 7 nodes about it, / 64
//   w          clamp(-f_z, 0, T) / T, Q7, T the contact threshold, as in support_solver.h
//   s          relative standard deviation of the pad's stiffness (stages/support/uncertainty_stage.cpp)
//   tables     steps^2, 8 fraction bits; factors Q16, at most kMaxFactor
//   sigma      square root, rounded half up to whole steps, at least 1; of shear twice that where the node is filled
//
// Forces are taken up to kMaxForce steps, so each term stays below 2^60. x and y share their numbers.
// Work is bounded by 100 loads and three square roots a node. Frame thread; no allocation after load. Not in the paper.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/result.h"
#include "solve/contact_mask.h"
#include "store/calibration.h"

namespace ruffini {

// Of fx, fy, fz of one node, in force steps.
struct NodeSigma {
  int32_t x = 0;
  int32_t y = 0;
  int32_t z = 0;
};

class NodeSigmaModel {
 public:
  static constexpr int kReportedLevels = 12;
  static constexpr int kQuietLevels = 7;
  static constexpr int kLocalTerms = 4;  // reading, contrast, step, rough
  static constexpr int kRoughReach = 3;  // nodes to each side
  static constexpr int64_t kMaxForce = (int64_t{1} << 20) - 1;
  static constexpr int32_t kMaxFactor = 1 << 18;  // 4
  // Shear of a filled node errs 1.6, 1.7 and 2.2 times as much (rms) as with all markers, 5, 10 and 20 % of them lost;
  // of other nodes at most 1.3 times, and pressure as ever (host/ruffini/fem/DESIGN.md, "Lost markers").
  static constexpr int32_t kFilledShear = 2;

  // Tensors support.error_reported, _quiet and _local. threshold_lsb: T in steps, above zero. stiffness_q20: s, at most a
  // half.
  [[nodiscard]] static Result<NodeSigmaModel> load(const Calibration& calibration, GridSize nodes,
                                                   int64_t threshold_lsb, int64_t stiffness_q20 = 0);

  // One value a node. is_filled: Displacement's.
  void run(std::span<const NodeForce> force, std::span<const uint8_t> is_filled, std::span<NodeSigma> sigma);

 private:
  // Shear (x and y) and normal.
  struct Axis {
    std::span<const int32_t> reported;
    std::span<const int32_t> quiet;
    std::span<const int32_t> local;
  };
  struct Neighbours;

  [[nodiscard]] Neighbours look_around(std::span<const NodeForce> force, int x, int y) const;
  void find_roughness(std::span<const NodeForce> force);
  [[nodiscard]] int32_t sigma_of(const Axis& axis, const Neighbours& around, size_t component) const;

  GridSize nodes_;
  int64_t threshold_lsb_ = 1;
  int64_t stiffness2_q16_ = 0;  // s^2
  std::array<Axis, 2> axis_;
  std::vector<int64_t> contrast2_;  // d_z^2
  std::vector<int64_t> along_x_;    // of 7 nodes side by side
  std::vector<int64_t> rough_;      // r^2
};

// Largest integer whose square is at most x. Precondition: x >= 0.
[[nodiscard]] int64_t floor_sqrt(int64_t x);

}  // namespace ruffini
