// How much the light has changed over a coarse grid on the gel: features of a wrench for gels without markers.
//
//   u = A / (A + B),  A = L_left(p) k_right,  B = L_right(p) k_left    p: pixel, L: signed distance to the gel's edge
//   cell = (floor(n_x u), floor(n_y v))                                v: likewise, of the top and bottom edge
//   f_ck = (2^4 sum of d_c over the pixels of cell k) / (pixels of k)  relative change, Q16, half up;
//                                                                      d: image/difference.h
//
// The gel is a quadrilateral in the picture, seen in perspective. Its top and bottom edge meet in a vanishing point;
// k_left and k_right are the distances of this point from the left and the right edge. They make u the place on the gel
// from the left edge (0) to the right one (1). The map from pixels to cells is made once, as runs along the rows: a
// frame costs one pass of additions over the gel's pixels. Not in the papers. Frame thread; no allocation after the
// constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"

namespace ruffini {

class PictureFeatures {
 public:
  static constexpr int kChannels = 3;

  PictureFeatures(const PictureFeatureSettings& settings, int width_px, int height_px);

  // All cells of B by rows, then those of G and of R.
  [[nodiscard]] size_t count() const { return kChannels * n_pixels_.size(); }
  // `change`: planes of B, G and R, width x height each.
  void run(std::span<const RelativeChange> change, std::span<int32_t> features);

 private:
  struct Run {
    size_t first = 0;  // pixel of a plane
    int length = 0;
    int cell = 0;
  };

  std::vector<Run> runs_;
  std::vector<int64_t> n_pixels_;  // of each cell
  std::vector<int64_t> sum_;
};

}  // namespace ruffini
