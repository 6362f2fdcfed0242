// Slope of cells that show nothing, from the nearest cells that do along each axis.
//
//   s = sum over left, right, above, below of s_i w(d_i), over sum of w(d_i), half up;  w(d) = 4096 / d, rounded down
//
// d_i: cells to the nearest one that shows something, in that direction; none beyond the border. A slope that is linear
// along both axes is continued as it is between two such cells. Zero where all four are missing. Not in the paper.
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

  // `n_kept`: pixels that show something, per cell; cells without any are written.
  void run(std::span<const int16_t> n_kept, std::span<CellSlope> slope);

 private:
  enum Direction : size_t { kLeft, kAbove, kRight, kBelow, kDirections };

  GridSize grid_;
  std::vector<uint32_t> empty_;                  // cells, ascending
  std::vector<uint16_t> distance_[kDirections];  // per cell; 0 = none; of empty ones only
};

}  // namespace ruffini
