// Converts colour change to surface slope on the depth grid (one value per step x step pixels).
//
//   S = sum of d over the n unmasked pixels of the cell, Q12
//   d' = (S / n - m) / (1 + m)              Q16; m: level of the frame's light (light.h), zero if it is not used
//   q = M . d' + N(d')                      Q14, clamped to +-16384; M at the cell's centre, Q12, from a coarse grid;
//                                           N (`bend`, optional): trilinear over the three changes
//   s = table(q)                            Q12, bilinear: index (q + 16384) >> 9, 9 fraction bits
//
// M is the response of a matt surface to the lamps; N covers clipped channels, the camera's response and shadows. The
// mean over the cell comes before the tables: averaging halves the pixels' noise before the nonlinearity. Pixels under
// a printed dot, at its rest position or its current one, carry no shading and are masked. A cell without pixels takes
// the values of its neighbours along x and y, weighted by nearness (photometric_fill.h).
//
// Skins of one colour that darken when pressed give depth directly, without slopes and Poisson:
//
//   z = depth(mean of d' over the three channels)   table from -1 to +1, linear between, half up
//
// Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "image/light.h"
#include "image/markers.h"
#include "image/photometric_fill.h"
#include "image/photometric_table.h"

namespace ruffini {

// Inputs and outputs of one row of cells.
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
  const int32_t* bend = nullptr;   // as slope; null if there is none
  std::array<int32_t, 3> bend_low_q16{};
  std::array<int32_t, 3> bend_shift{};                 // distance of two table lines: 2^9 (shift + 9 bits) in Q16
  const std::array<int32_t, 17>* per_count = nullptr;  // of B, G, R: 2^20 / (n (1 + m)); 0 for n = 0
  std::array<int32_t, 3> level_q16{};                  // m / (1 + m)
  CellSlope* out = nullptr;
  int16_t* n_kept = nullptr;  // per cell
};
using CellRun = void (*)(const CellRow& row);

class Photometric {
 public:
  static constexpr int kSlopeSize = PhotometricTable::kSlopeSize;
  static constexpr int kBendSize = PhotometricTable::kBendSize;

  Photometric(const BoardSettings& board, const PhotometricTable& table, CellRun version);
  Photometric(const BoardSettings& board,
              const PhotometricTable& table);  // the fastest version that this processor supports

  // `difference`: planes of B, G and R. `level`: within +-2^14; ignored if the table is not balanced.
  void run(std::span<const RelativeChange> difference, std::span<const Marker> markers, const LightLevel& level,
           std::span<CellSlope> out);

  // Replaces run() for depth tables. Masked cells are read through their dots.
  void run_depth(std::span<const RelativeChange> difference, const LightLevel& level, std::span<DisplacementUm> out);

  [[nodiscard]] bool is_of_depth() const { return !depth_.empty(); }
  [[nodiscard]] GridSize cells() const { return grid_; }
  [[nodiscard]] bool is_balanced() const { return is_balanced_; }

 private:
  void mask_markers(std::span<const Marker> markers);
  void mask_disc(int64_t x_q16, int64_t y_q16);
  void set_level(const LightLevel& level);

  int width_px_;
  int height_px_;
  int step_px_;
  GridSize grid_;
  int64_t mask_radius_q16_;
  CellRun run_;
  std::vector<int16_t> unmix_;  // six planes, per cell
  std::vector<int32_t> slope_;  // the table, packed
  std::vector<int32_t> bend_;   // the same
  std::vector<int16_t> depth_;
  std::array<int32_t, 3> bend_low_q16_{};
  std::array<int32_t, 3> bend_shift_{};
  bool is_balanced_;
  std::array<std::array<int32_t, 17>, 3> per_count_{};  // CellRow
  std::array<int32_t, 3> level_q16_{};
  std::vector<int16_t> keep_;    // per pixel
  std::vector<int16_t> n_kept_;  // per cell
  PhotometricFill fill_;
};

}  // namespace ruffini
