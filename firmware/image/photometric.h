// Colour change -> surface slope, on the depth grid (one value per step x step pixels).
//
//   S = sum of d over the cell's unmasked pixels, n of them
//   q = (M . S)_Q16 / n                     Q14, clamped to +-16384; M at the cell's middle, Q12, from the coarse lattice
//   s = table(q)                            Q12, bilinear: index (q + 16384) >> 9, 9 fraction bits
//
// The mean over the cell comes before the table: what noise the cell's pixels have is halved before it is bent.
// Pixels under a printed dot, where it rests or where it is now, carry no shading and are masked. A cell with no pixel
// left takes what its neighbours along x and along y have, each weighted by its nearness (photometric_fill.h).
// Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "image/markers.h"
#include "image/photometric_fill.h"

namespace ruffini {

// Views into the calibration, shapes as in proto/CALIBRATION.md.
struct PhotometricTable {
  std::span<const int16_t> unmix;  // [n_cells_y][n_cells_x][2][3]
  GridSize cells;
  std::span<const int16_t> slope;  // [65][65][2]
};

// What the cells read and write, one row of them at a time.
struct CellRow {
  int step_px = 1;
  int n_cells = 0;
  ptrdiff_t width = 0;              // pixels of a row of `change` and `keep`
  ptrdiff_t plane = 0;              // values of a colour's plane
  const int16_t* change = nullptr;  // planes of B, G and R
  const int16_t* keep = nullptr;    // per pixel: -1, or 0 where masked
  ptrdiff_t unmix_plane = 0;
  const int16_t* unmix = nullptr;  // six planes, per cell
  const int32_t* slope = nullptr;  // the table, x in the low half and y in the high one
  CellSlope* out = nullptr;
  int16_t* n_kept = nullptr;  // per cell
};
using CellRun = void (*)(const CellRow& row);

class Photometric {
 public:
  static constexpr int kSlopeSize = 65;

  Photometric(const BoardSettings& board, const PhotometricTable& table, CellRun version);
  Photometric(const BoardSettings& board, const PhotometricTable& table);  // the fastest that this processor runs

  // `difference`: planes of B, G and R.
  void run(std::span<const RelativeChange> difference, std::span<const Marker> markers, std::span<CellSlope> out);

  [[nodiscard]] GridSize cells() const { return grid_; }

 private:
  void mask_markers(std::span<const Marker> markers);
  void mask_disc(int64_t x_q16, int64_t y_q16);

  int width_px_;
  int height_px_;
  int step_px_;
  GridSize grid_;
  int64_t mask_radius_q16_;
  CellRun run_;
  std::vector<int16_t> unmix_;   // six planes, per cell
  std::vector<int32_t> slope_;   // the table, packed
  std::vector<int16_t> keep_;    // per pixel
  std::vector<int16_t> n_kept_;  // per cell
  PhotometricFill fill_;
};

}  // namespace ruffini
