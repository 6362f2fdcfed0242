// Rows of a picture that stand aside or come from elsewhere: markers of a lattice tell by jumping together.
//
//   jump(j, i) = d(j + 1, i) - d(j, i)                                 displacement of marker (row, column), px
//   bend(j, i) = jump(j, i) - mean of jump(j - 1, i) and jump(j + 1, i)    of those that there are
//   slipped: along x or y, of some j: nine tenths of the columns whose markers are known have a bend of more than
//            max(kLeastPx, pitch / 32) to the same side; half of the columns at least must be known
//
// Presses on the twin, flat ones as wide as the pad among them, bend 0.2 px at most: next to a contact the pad stands still.
// A slip between the same two rows of markers and back is not seen. For lattices of printed markers in one view.
// Frame thread; no allocation. Not in the papers.
#pragma once

#include <span>

#include "image/markers.h"

namespace ruffini {

// `markers`: size.count() of them, by rows.
[[nodiscard]] bool has_slipped_rows(std::span<const Marker> markers, GridSize size);

}  // namespace ruffini
