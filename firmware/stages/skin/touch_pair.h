// Decides whether an apparent touch of a skin is two fingers side by side: one position against a pair of positions.
//
//   patch    5 x 5 taxels around the touch; u = sink that no other touch explains, clamped to -1 to 16
//   seen     per taxel, weighted by w = 1 / sqrt(kNoise^2 + (kPart u)^2): w u / 2, and w (u - (u_above + u_below) / 2);
//            a finger's tail along the skin's stiff axis is smooth, so curvature is more telling than sink
//   one      strength and position with the least sum of squares J_1; two: the same with two touches, J_2
//   places   every kGridStep-th step of the reach table up to kGridHalf steps away, then kHalvings times around the
//            best in half the step. Limits: on the skin, within kOnTaxel half steps of a taxel along both axes; two
//            touches are kNear to kFar steps apart, and one is at most kEven times as strong as the other
//   is two   (J_1 - J_2) kSlack / (J_2 + kSlack n) > pair, n taxels; `pair` exceeds all single touches of the fit
//
// The search is bounded: 49 places, then 6 rounds of 81 pairs. Not in the paper. Frame thread; no allocation.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "stages/skin/taxel_tables.h"

namespace ruffini {

class TouchPair {
 public:
  static constexpr int kRows = 7;  // rows of the patch, including those above and below it
  static constexpr int kColumns = 5;
  static constexpr size_t kNodes = size_t{kRows} * kColumns;
  static constexpr size_t kCells = kNodes - size_t{2} * kColumns;
  static constexpr int64_t kNoiseQ12 = 82;  // 0.02
  static constexpr int64_t kPartQ8 = 13;    // 0.05
  static constexpr int kGridHalf = 6;       // steps of the reach table
  static constexpr int kGridStep = 2;
  static constexpr int kGridSide = 2 * kGridHalf / kGridStep + 1;
  static constexpr int kHalvings = 3;
  static constexpr int kRounds = 2;  // refinements around the best place, per step size
  static constexpr int64_t kOnTaxel = 5;
  static constexpr int64_t kNear = 4;
  static constexpr int64_t kFar = 8;
  static constexpr std::array<int64_t, 2> kEven = {8, 5};
  static constexpr int64_t kMinStrengthQ12 = 205;  // strength, 0.05
  static constexpr int64_t kSlack = 3;

  struct Member {
    int64_t x_um = 0;
    int64_t y_um = 0;
    int64_t strength_q12 = 0;
  };

  // `sink_q12`: of every taxel, without the part explained by other touches. Returns true, and sets members(), for two.
  bool find(const TaxelTables& tables, std::span<const int64_t> sink_q12, size_t taxel);

  [[nodiscard]] const std::array<Member, 2>& members() const { return members_; }

 private:
  using Values = std::array<int64_t, kNodes>;
  using Features = std::array<int32_t, 2 * kCells>;

  struct Place {
    int64_t x_um = 0;  // relative to the taxel
    int64_t y_um = 0;
    Features made{};  // by a touch one unit strong
    int64_t own = 0;  // products, Q6: with itself, with what is seen
    int64_t with = 0;
  };

  struct Solved {
    int64_t gain = -1;  // reduction of the sum of squares by the pair, Q6; negative: no solution
    std::array<int64_t, 2> strength_q12{};
  };

  void load_patch(const TaxelTables& tables, std::span<const int64_t> sink_q12, size_t taxel);
  void describe(const Values& value, int shift, Features& out) const;
  void place(const TaxelTables& tables, int64_t x_um, int64_t y_um, Place& out) const;
  [[nodiscard]] Solved solve(const Place& a, const Place& b, int64_t step_um) const;
  void place_around(const TaxelTables& tables, const Place& middle, int64_t step_um, std::span<Place, 9> out) const;
  [[nodiscard]] int64_t best_single(const TaxelTables& tables);
  [[nodiscard]] int64_t best_pair(const TaxelTables& tables);

  std::array<int, kNodes> node_{};  // taxels of the patch, row by row; -1: none
  size_t taxel_ = 0;
  int64_t n_cells_ = 0;
  std::array<int64_t, kCells> weight_q4_{};
  Features seen_{};  // Q8
  std::array<Place, size_t{kGridSide} * kGridSide> grid_{};
  std::array<Place, 9> around_a_{};
  std::array<Place, 9> around_b_{};
  std::array<Member, 2> members_{};
};

}  // namespace ruffini
