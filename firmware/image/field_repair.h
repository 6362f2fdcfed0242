// Displacement on a lattice: finds single values that contradict all their neighbours, and fills missing values.
//
//   line      2 f_i - f_a - f_b, a and b opposite neighbours: along x, y and both diagonals (f odd about the border)
//   residual  sum of the two middle ones of the four lines, per component; 4 x the error of f_i. Its size is
//             sqrt(x^2 + y^2 + (z / 4)^2), since depth is four times as noisy as the markers' displacement along the surface
//   outlier   residual above 4 `least`, the largest among the eight neighbours, and with f_i - residual / 4 in its place
//             > sqrt(10) x the second largest residual of the neighbours, or > 7 x the third largest
//   filled    ring by ring the mean of the known ones of the eight neighbours; then kSweeps Gauss-Seidel sweeps of the
//             thin plate's stencil, two or more lines inside the border: the smoothest field through what is known
//
// The edge of a contact bends a whole line of neighbours, so their residuals are as large as its own; the neighbours of a
// wrong marker agree once it is removed. At most kRounds rounds, so that adjacent outliers are found too. Values carry 4
// more fraction bits than the input. A field without outliers and missing values is not changed.
// Frame thread; no allocation after the constructor. Not in the paper.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

// Of a displacement.
struct FieldValue {
  int32_t x = 0;
  int32_t y = 0;
  int32_t z = 0;
};

class FieldRepair {
 public:
  static constexpr int kRounds = 8;
  static constexpr int kSweeps = 24;
  static constexpr int kFewestLines = 5;    // of the lattice along each axis; fewer do not show an outlier
  static constexpr int kMostPlatePart = 4;  // more missing than a quarter of the lattice: the rings' mean stands
  static constexpr int32_t kMaxInput = 32'768;

  static constexpr int64_t kPitchesOfOutlier = 16;
  static constexpr int64_t kLeastOutlierUm = 30;

  explicit FieldRepair(GridSize size);

  // `least` of run(), 1/8 um: a sixteenth of the pitch, and at least six times the noise of a marker (5 um). Returns
  // kNoOutliers if the pitch exceeds 3/8 of the pad's thickness: a contact on so coarse a lattice may move one marker
  // alone, which is no outlier (taking it for one cost 25 % of the force with markers half a thickness apart).
  [[nodiscard]] static int32_t least_q3(int64_t pitch_x_um, int64_t pitch_y_um, int64_t thickness_um);
  static constexpr int32_t kNoOutliers = 8 * kMaxInput;

  // Marks outliers in `is_missing` with kOutlier and gives every missing place of `field` a value; with nothing known
  // `field` stays. |field| <= kMaxInput. Returns the number of outliers.
  static constexpr uint8_t kOutlier = 2;
  int run(std::span<FieldValue> field, std::span<uint8_t> is_missing, int32_t least);

 private:
  struct Place {
    int x = 0;
    int y = 0;
  };

  [[nodiscard]] size_t index(int x, int y) const { return static_cast<size_t>(y * size_.n_x + x); }
  // In value_, which has one line more at each border.
  [[nodiscard]] size_t padded(int x, int y) const { return static_cast<size_t>((y + 1) * (size_.n_x + 2) + x + 1); }
  template <typename Visit>
  void around(int x, int y, Visit visit) const;

  void fill();
  void fill_rings();
  void fill_plate();
  void extend(int x, int y);
  void extend_all();
  [[nodiscard]] FieldValue residual(int x, int y) const;
  [[nodiscard]] bool is_candidate(int x, int y, int64_t least2) const;
  bool take_out(int x, int y);
  int find_outliers(int64_t least);

  GridSize size_;
  std::vector<FieldValue> value_;  // Q4
  std::vector<int64_t> residual2_;
  std::vector<uint8_t> known_;
  std::vector<uint8_t> reached_;
  std::vector<uint8_t> next_;
  std::vector<Place> places_;  // that a loop works on
};

}  // namespace ruffini
