// Standard deviation of each nodal force of the second pass, predicted from the field itself. The model and its reasons
// are in host/ruffini/fem/uncertainty.py, the tables in proto/CALIBRATION.md.
//
//   variance_c = table_c[level] + (reading_c + s^2) f_c^2 + step_c m_c^2 + w (contrast_c d_c^2 + rough_c r^2)
//
//   level      bit width of |f_z|; for a node without f_z, of the largest |f_z| of its eight neighbours
//   d          f_c minus the mean of the eight neighbours, in 1/8 steps; forces outside the grid are zero
//   m          largest absolute difference from a neighbour
//   r^2        sum of d_z^2 over the surrounding 7 x 7 nodes, / 64
//   w          clamp(-f_z, 0, T) / T, Q7, T the contact threshold, as in support_solver.h
//   s          relative standard deviation of the pad's stiffness (stages/support/uncertainty_stage.cpp)
//   tables     steps^2, 8 fraction bits; factors Q16, at most kMaxFactor
//   sigma      square root, rounded half up to whole steps, at least 1; times kFilledShear_halves / 2 for shear at
//              filled nodes, kFilledNormal_halves / 2 for the normal force where depth is filled too,
//              kBesideFilled_halves / 2 for what is measured beside a node where it is filled
//
// Forces are clamped to kMaxForce steps, so each term stays below 2^60. x and y share their tables. Cost per node: 100
// loads and three square roots. Frame thread; no allocation after load. Not in the paper.
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

// Standard deviations of fx, fy, fz of one node, in force steps.
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
  // Chosen on the contacts bench.states.FRESH with a hole of 3.3 mm. Cautious for single lost markers: there the rms
  // error of shear at filled nodes is 1.6 to 2.2 times that with all markers, at others at most 1.3 times
  // (host/ruffini/fem/DESIGN.md, "Lost markers").
  static constexpr int32_t kFilledShear_halves = 5;
  static constexpr int32_t kFilledNormal_halves = 8;
  static constexpr int32_t kBesideFilled_halves = 3;

  // Loads the tensors support.error_reported, _quiet and _local. threshold_lsb: T in steps, above zero. stiffness_q20:
  // s, at most one half.
  [[nodiscard]] static Result<NodeSigmaModel> load(const Calibration& calibration, GridSize nodes,
                                                   int64_t threshold_lsb, int64_t stiffness_q20 = 0);

  // Writes one value per node. `filled`: see base/filled.h.
  void run(std::span<const NodeForce> force, std::span<const uint8_t> filled, std::span<NodeSigma> sigma);

 private:
  // Tables of one axis: shear (x and y) or normal.
  struct Axis {
    std::span<const int32_t> reported;
    std::span<const int32_t> quiet;
    std::span<const int32_t> local;
  };
  struct Neighbours;
  // Lines of nodes, both ends included; empty if min > max.
  struct Box {
    int min_x = 0;
    int max_x = -1;
    int min_y = 0;
    int max_y = -1;
  };

  // Smallest box of the nodes with a force; empty without force. grown(): with `reach` nodes more at each side.
  [[nodiscard]] Box forced(std::span<const NodeForce> force) const;
  [[nodiscard]] Box grown(const Box& box, int reach) const;
  [[nodiscard]] Neighbours neighbours_of(std::span<const NodeForce> force, int x, int y) const;
  // Multiplies the sigmas at filled nodes and beside them.
  void grow_filled(std::span<const uint8_t> filled, std::span<NodeSigma> sigma) const;
  // Computes r^2 of the nodes in `loud`. Precondition: there is no force outside it.
  void find_roughness(std::span<const NodeForce> force, const Box& loud);
  [[nodiscard]] int32_t sigma_of(const Axis& axis, const Neighbours& around, size_t component) const;

  GridSize nodes_;
  int64_t threshold_lsb_ = 1;
  int64_t stiffness2_q16_ = 0;  // s^2
  std::array<Axis, 2> axis_;
  std::vector<int64_t> contrast2_;  // d_z^2
  std::vector<int64_t> along_x_;    // sums over 7 adjacent nodes of a row
  std::vector<int64_t> rough_;      // r^2
};

// Returns the largest integer whose square is at most x. Precondition: x >= 0.
[[nodiscard]] int64_t floor_sqrt(int64_t x);

}  // namespace ruffini
