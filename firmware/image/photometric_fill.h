// Fills the slope of masked cells from the nearest unmasked cells along each axis.
//
//   s = sum over left, right, above, below of s_i w(d_i), over sum of w(d_i), half up;  w(d) = 4096 / d, rounded down
//
// d_i: distance in cells to the nearest unmasked cell in that direction; none beyond the border. A slope that is linear
// along both axes is continued exactly. Zero if all four are missing. Not in the paper.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "base/image_view.h"

namespace ruffini {

struct CellSlope {
  Slope x;
  Slope y;
};

class PhotometricFill {
 public:
  explicit PhotometricFill(GridSize grid);

  // `n_kept`: number of unmasked pixels of each cell. Writes the cells without any.
  void run(std::span<const int16_t> n_kept, std::span<CellSlope> slope);

 private:
  enum Direction : size_t { kLeft, kAbove, kRight, kBelow, kDirections };

  GridSize grid_;
  std::vector<uint32_t> empty_;                  // cells, ascending
  std::vector<uint16_t> distance_[kDirections];  // per masked cell; 0: none
};

}  // namespace ruffini
