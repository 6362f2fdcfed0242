// Moments of the dent in a depth map: eight features of a wrench for gels that measure depth by their colours.
//
//   e = max(-u_z - kLeast, 0)                       indentation of a cell beyond noise, 1/8 um
//   f_0, f_1, f_2   mean of e; share of cells with e > 0; largest e       volume, area, deepest point
//   f_3, f_4        mean of e X, e Y                                      centroid times volume
//   f_5, f_6, f_7   mean of e X X, e Y Y, e X Y                           second moments times volume
//
// Means are over the cells that lie inside the window; X and Y are the cell's place from the pad's centre, in halves of
// the pad's size, Q11. Units: f_1 2^-24 of the window, the others 2^-14 um; each at most 2^26, half up, zero at rest.
//
// Only sums, about the pad's centre: all are continuous from zero on. A centroid or a central moment would be divided
// by the volume, and jump at the first touched cell. A pad that is stiffer towards its rim by a quadratic in X and Y,
// or the moment of a force about the centre, is linear in these sums.
//
// Places are those of the undeformed surface. Not in the papers. Frame thread; one pass over the window's cells, no
// allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"

namespace ruffini {

class DepthMoments {
 public:
  static constexpr size_t kCount = 8;
  // 10 um: on the twin of a gel with 160 x 120 cells noise of a cell is 1.1 um, and 8.4 at most in 100 untouched
  // pictures. From 3 to 40 um the error of the force is the same within a tenth.
  static constexpr int32_t kLeast = 80;

  explicit DepthMoments(const BoardSettings& board);

  // `depth`: u_z of all cells by rows, negative where pressed.
  void run(std::span<const DisplacementUm> depth, std::span<int32_t, kCount> features) const;

 private:
  // The cells inside the window along one axis.
  struct Axis {
    size_t first = 0;
    std::vector<int32_t> place_q11;
  };

  [[nodiscard]] static Axis axis(int n, int step_px, int64_t center_mpx, const CameraSettings& camera, int64_t min_um,
                                 int64_t max_um, int64_t size_um);

  size_t n_x_;  // cells of a row of the map
  Axis x_;
  Axis y_;
};

}  // namespace ruffini
