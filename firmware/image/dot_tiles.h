// Tiles of 8 x 8 pixels of a grey image that may hold a part of a dot (dots.h): open ones. Of a picture with dots most
// are closed, and are passed over without their background.
//
// C: the whole tiles that lie in the box of every pixel of a tile, their sum S; M: the largest grey in any of these
// boxes; A: the largest area of a box. Then the mean of a box of area a is at most
//   (S + (a - |C|) M) / a <= (S + (A - |C|) M) / A, the second because S <= |C| M
// A dark dot's weight does not fall if its background rises: a tile whose darkest pixel has no weight on this
// background, rounded up, is closed. For light dots the same holds of -grey.
//
// Bounds: S + (A - |C|) M is below 2^31 (DotDetector::kMaxBoxRadiusPx). Frame thread; no allocation after the
// constructor.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "board/settings.h"

namespace ruffini {

struct DotParameters {
  int width_px = 0;
  int height_px = 0;
  int box_radius_px = 0;
  int threshold_1e3 = 0;
  Polarity polarity = Polarity::kDark;
  int min_area_px = 0;
  int max_area_px = 0;
};

// Rows of pixels that a row of tiles has, and what is known of the tiles.
struct TileRow {
  int width = 0;
  int n_rows = 0;
  bool is_light = false;
  const uint16_t* grey = nullptr;  // the first row, of `width` as the others
  int32_t* column_sum = nullptr;   // of each pixel column
  int32_t* min_grey = nullptr;     // of each tile; for light dots of -grey, as max_grey
  int32_t* max_grey = nullptr;
  int32_t* sum = nullptr;
};
// Bounds of a row of tiles; the sums' corners belong to each tile's C.
struct TileBounds {
  int n_tiles = 0;
  bool is_light = false;
  int32_t threshold_q15 = 0;
  int32_t area = 0;  // A
  int32_t inverse_q32 = 0;
  int32_t n_rows = 0;                  // of C, px
  const int32_t* n_columns = nullptr;  // of C, px
  const int32_t* high_right = nullptr;
  const int32_t* high_left = nullptr;
  const int32_t* low_right = nullptr;
  const int32_t* low_left = nullptr;
  const int32_t* min_grey = nullptr;
  const int32_t* max_grey_in_boxes = nullptr;  // M
  int16_t* open = nullptr;
};

struct TileKernels {
  void (*measure)(const TileRow& row);
  // values[i] = max(values[i], values[i + by]) for all i < n
  void (*widen)(int32_t* values, int n, int by);
  void (*bound)(const TileBounds& row);
  // sums[i] += values[i]
  void (*add)(int32_t* sums, const int32_t* values, int n);
  void (*add_grey)(int32_t* sums, const uint16_t* grey, int n);
};

class DotTiles {
 public:
  static constexpr int kSide = 8;  // px

  DotTiles(const DotParameters& parameters, const TileKernels& kernels);

  void measure(std::span<const uint16_t> grey);
  [[nodiscard]] int n_rows() const { return n_y_; }
  // Of each tile in a row of tiles: 0 if it is closed. Valid until the next measure(), as the others.
  [[nodiscard]] const int16_t* open_tiles(int row) const { return open_.data() + at(row, n_x_); }
  [[nodiscard]] bool has_open_tile(int row) const { return has_open_tile_[static_cast<size_t>(row)] != 0; }
  // Adds the rows [from, to) of pixels to the sums of columns.
  void add_rows(std::span<const uint16_t> grey, int from, int to, int32_t* sums) const;

 private:
  [[nodiscard]] static ptrdiff_t at(int row, int stride) { return ptrdiff_t{row} * stride; }
  void widen();
  void bound(int row);

  DotParameters p_;
  TileKernels run_;
  int n_x_;
  int n_y_;
  int inner_;  // C goes so many tiles beyond its tile; -1: there is no C
  int outer_;  // boxes reach so many tiles beyond it
  int max_grey_stride_;
  int sum_stride_;
  int32_t area_;
  int32_t inverse_q32_;
  std::vector<int32_t> column_sum_;  // of each row of tiles
  std::vector<int32_t> min_grey_;
  std::vector<int32_t> max_grey_;  // with `outer_` tiles around; widen() makes M of it, at the window's first tile
  std::vector<int32_t> sum_;       // of all tiles above and to the left, with `inner_` columns at both sides
  std::vector<int32_t> row_sum_;   // of the tiles of one row
  std::vector<int32_t> n_columns_;
  std::vector<int16_t> open_;
  std::vector<uint8_t> has_open_tile_;
};

}  // namespace ruffini
