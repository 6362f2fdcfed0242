// Colour change -> surface slope, on the depth grid (one value per step x step pixels).
//
//   q = (M . d + 2^9) >> 10                 Q14, clamped to +-16384; M per pixel, Q12, from the coarse lattice
//   s = table(q)                            Q12, bilinear: index (q + 16384) >> 9, 9 fraction bits
//   s of a depth cell = mean over its unmasked pixels, rounded half up
//
// Pixels under a printed dot, where it rests or where it is now, carry no shading and are masked. A
// cell with no pixel left takes the mean of the cells in a box around it that have one (radius
// doubles until there is one; zero if the whole image is masked).
// Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "image/markers.h"

namespace ruffini {

struct CellSlope {
  Slope x;
  Slope y;
};

// Views into the calibration, shapes as in proto/CALIBRATION.md.
struct PhotometricTable {
  std::span<const int16_t> unmix;  // [n_cells_y][n_cells_x][2][3]
  GridSize cells;
  std::span<const int16_t> slope;  // [65][65][2]
};

class Photometric {
 public:
  static constexpr int kSlopeSize = 65;

  Photometric(const BoardSettings& board, const PhotometricTable& table);

  void run(std::span<const RelativeChange> difference, std::span<const Marker> markers, std::span<CellSlope> out);

  [[nodiscard]] GridSize cells() const { return grid_; }

 private:
  void mask_markers(std::span<const Marker> markers);
  void mask_disc(int64_t x_q16, int64_t y_q16);
  [[nodiscard]] CellSlope pixel_slope(const RelativeChange* d, const int16_t* m) const;
  void fill_masked(std::span<CellSlope> out);

  int width_px_;
  int height_px_;
  int step_px_;
  GridSize grid_;
  int64_t mask_radius_q16_;
  int fill_radius_;
  std::vector<int16_t> unmix_;      // per pixel, 6
  std::vector<int16_t> slope_;      // copy of the table
  std::vector<uint8_t> is_masked_;  // per pixel
  std::vector<uint8_t> is_empty_;   // per cell
};

}  // namespace ruffini
