// Repairs a displacement field on a lattice: finds single values that contradict all their neighbours, and fills
// missing values.
//
//   line      2 f_i - f_a - f_b, a and b opposite neighbours: along x, y and both diagonals (f is extended oddly at
//             borders)
//   residual  per component, sum of the two middle values of the four lines; 4 x the error of f_i. Its norm is
//             sqrt(x^2 + y^2 + (z / 4)^2), because depth is four times as noisy as the displacement along the surface
//   outlier   residual above 4 `least` and the largest of its neighbourhood; and, with f_i - residual / 4 in its place,
//             > sqrt(10) x the second largest residual of the neighbours, or > 7 x the third largest
//   filled    ring by ring the mean of the known values among the eight neighbours; then kSweeps Gauss-Seidel sweeps of
//             the thin-plate stencil, two or more lines inside the border: the smoothest field through the known values
//
// The edge of a contact bends a whole line of neighbours, so their residuals are as large as its own, whereas the
// neighbours of a wrong marker agree once it is removed. At most kRounds rounds run, so that adjacent outliers are
// found too. Values carry 4 more fraction bits than the input. A field without outliers and missing values is
// unchanged. Frame thread; no allocation after the constructor. Not in the paper.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

// A displacement.
struct FieldValue {
  int32_t x = 0;
  int32_t y = 0;
  int32_t z = 0;
};

class FieldRepair {
 public:
  static constexpr int kRounds = 8;
  static constexpr int kSweeps = 24;
  static constexpr int kMinLines = 5;  // along each axis; smaller lattices do not show an outlier
  // If more than a quarter of the lattice is missing, only the means of the rings are used
  static constexpr int kMaxMissingPart = 4;
  static constexpr int32_t kMaxInput = 32'768;

  static constexpr int64_t kPitchesOfOutlier = 16;
  static constexpr int64_t kMinOutlierUm = 30;

  explicit FieldRepair(GridSize size);

  // Returns `least` of run(), in 1/8 um: a sixteenth of the pitch, and at least six times the noise of a marker (5 um).
  // Returns kNoOutliers if the pitch exceeds 3/8 of the pad's thickness: on so coarse a lattice a contact may move a
  // single marker, which is not an outlier (treating it as one cost 25 % of the force with a pitch of half the
  // thickness).
  [[nodiscard]] static int32_t least_q3(int64_t pitch_x_um, int64_t pitch_y_um, int64_t thickness_um);
  static constexpr int32_t kNoOutliers = 8 * kMaxInput;

  // Marks outliers in `is_missing` with kOutlier and fills every missing value of `field`; without known values `field`
  // is unchanged. Precondition: |field| <= kMaxInput. Returns the number of outliers.
  static constexpr uint8_t kOutlier = 2;
  int run(std::span<FieldValue> field, std::span<uint8_t> is_missing, int32_t least);

 private:
  struct Place {
    int x = 0;
    int y = 0;
  };

  [[nodiscard]] size_t index(int x, int y) const { return static_cast<size_t>(y * size_.n_x + x); }
  // Index into value_, which has one more line at each border.
  [[nodiscard]] size_t padded(int x, int y) const { return static_cast<size_t>((y + 1) * (size_.n_x + 2) + x + 1); }
  template <typename Visit>
  void for_each_neighbour(int x, int y, Visit visit) const;

  void fill();
  void fill_rings();
  void fill_plate();
  void extend(int x, int y);
  void extend_all();
  [[nodiscard]] FieldValue residual(int x, int y) const;
  [[nodiscard]] bool is_candidate(int x, int y, int64_t least2) const;
  bool remove_outlier(int x, int y);
  int find_outliers(int64_t least);

  GridSize size_;
  std::vector<FieldValue> value_;  // Q4
  std::vector<int64_t> residual2_;
  std::vector<uint8_t> known_;
  std::vector<uint8_t> reached_;
  std::vector<uint8_t> next_;
  std::vector<Place> places_;  // work list of the current loop
};

}  // namespace ruffini
