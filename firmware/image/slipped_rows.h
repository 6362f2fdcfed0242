// Detects displaced rows of a picture: all markers of a lattice row jump together.
//
//   jump(j, i) = d(j + s, i) - d(j, i)       d: displacement of the marker in row j, column i, px
//   bend(j, i) = jump(j, i) - mean of jump(j - s, i) and jump(j + s, i), as far as these exist
//   slipped      for some j, along x or y, nine tenths of the known columns bend to the same side by more than the
//                limit; at least half of the columns must be known
//   dots         s = 1, limit max(0.4 px, pitch / 32): presses on the twin, flat faces as wide as the pad included,
//                bend at most 0.2 px
//   patches      of a texture, which overlap and show a jump over three rows: s = 2, limit 0.2 px (presses bend at most
//                0.07 px); or nine tenths of a row are lost, as where rows stand so far aside that no patch is found
//
// Limit: rows that slip and return between two adjacent marker rows are not detected. For lattices in one view.
// Frame thread; no allocation. Not in the papers.
#pragma once

#include <cstdint>
#include <span>

#include "image/markers.h"

namespace ruffini {

enum class RowsOf : uint8_t { kDots, kPatches };

// True if rows have slipped. `markers`: size.count() of them, row by row.
[[nodiscard]] bool has_slipped_rows(std::span<const Marker> markers, GridSize size, RowsOf what);

}  // namespace ruffini
