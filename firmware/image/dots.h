// Detects printed dots in a grey image: sub-pixel centres of spots darker (or lighter) than their surroundings.
//
//   background = (box sum x inverse + 2^31) >> 32, box of radius r clipped at the border, inverse = 2^32 / its area,
//                half up
//   v = background - grey (dark dots) or grey - background (light ones)
//   weight = v - (background (threshold 2^15 / 1000) >> 15), where positive
//   centre = sum(weight position) / sum(weight) over a 4-connected component, Q16, rounded down
//
// The weight falls to zero at the component's edge, so the centre moves smoothly as the dot crosses the pixel grid.
// Components that touch the border or whose area is outside [min, max] are dropped. Grey is in 1/16 levels of three
// channels together (image/difference.h). Tiles without a weight are passed over (image/dot_tiles.h). Frame thread; no
// allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "image/blobs.h"
#include "image/dot_tiles.h"

namespace ruffini {

struct Dot {
  ImagePx x;
  ImagePx y;
  int area_px = 0;
};

// Inputs of one row of weights; `inverse_q32` and the sums belong to each pixel's box.
struct DotRow {
  int width = 0;
  int box_radius_px = 0;
  bool is_light = false;
  int32_t threshold_q15 = 0;
  const uint16_t* entering = nullptr;  // the row that enters the boxes, and below the row that leaves them
  const uint16_t* leaving = nullptr;
  const uint16_t* grey = nullptr;
  const int16_t* open = nullptr;  // of each tile (dot_tiles.h): 0 if its weights are zero
  const int32_t* inverse_q32 = nullptr;
  int32_t* column_sum = nullptr;
  int32_t* prefix_sum = nullptr;  // box_radius_px + 1 zeros, then `width` sums, then room for box_radius_px more
  int16_t* weight = nullptr;
};
struct DotKernels {
  void (*weigh)(const DotRow& row);
  TileKernels tiles;
};

class DotDetector {
 public:
  static constexpr int kMaxBoxRadiusPx = 200;  // keeps the sum of a box within 31 bits: 401^2 pixels of 16 x 765
  static constexpr int kMaxDots = 4096;

  DotDetector(const DotParameters& parameters, const DotKernels& version);
  explicit DotDetector(const DotParameters& parameters);  // selects the fastest version that this processor supports

  // Returns the dots of `grey` (width x height) in the order of their first pixels; valid until the next call.
  std::span<const Dot> detect(std::span<const uint16_t> grey);

 private:
  void start(std::span<const uint16_t> grey, int y);
  void weigh_row(std::span<const uint16_t> grey, int y);
  void invert_areas(int n_rows);

  DotParameters p_;
  DotKernels run_;
  DotTiles tiles_;
  std::vector<uint16_t> no_row_;      // zeros: the row that enters or leaves beyond the border
  std::vector<int32_t> inverse_q32_;  // inverse area of each pixel's box, for n_box_rows_ rows
  int n_box_rows_ = 0;
  std::vector<int32_t> column_sum_;  // grey over the rows of the box
  std::vector<int32_t> prefix_sum_;
  Blobs blobs_;
  std::vector<int16_t> weight_;  // of the current row
  std::vector<Dot> dots_;
};

}  // namespace ruffini
