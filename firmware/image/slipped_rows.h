// Detects displaced rows of a picture: all markers of a lattice row jump together.
//
//   jump(j, i) = d(j + 1, i) - d(j, i)       d: displacement of the marker in row j, column i, px
//   bend(j, i) = jump(j, i) - mean of jump(j - 1, i) and jump(j + 1, i), as far as these exist
//   slipped      for some j, along x or y, nine tenths of the known columns bend to the same side by more than
//                max(0.4 px, pitch / 32); at least half of the columns must be known
//
// Presses on the twin, flat faces as wide as the pad included, bend at most 0.2 px. Limit: rows that slip and return
// between two adjacent marker rows are not detected. For lattices of printed markers in one view.
// Frame thread; no allocation. Not in the papers.
#pragma once

#include <span>

#include "image/markers.h"

namespace ruffini {

// True if rows have slipped. `markers`: size.count() of them, row by row.
[[nodiscard]] bool has_slipped_rows(std::span<const Marker> markers, GridSize size);

}  // namespace ruffini
