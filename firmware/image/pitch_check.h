// Checks that the markers at rest have the board's spacing: another pad, resolution or standoff would scale all
// displacements, and nothing else would show it.
//
//   k = sum e . p / sum e . e        p: rest positions, e: nominal ones (px), both relative to their means
//
// Returns true if |k - 1| <= 15 %, or if there is nothing to compare: fewer than 8 markers, or positions that
// board.toml does not list. Not in the papers.
#pragma once

#include <span>

#include "board/settings.h"
#include "image/markers.h"

namespace ruffini {

[[nodiscard]] bool pitch_fits(std::span<const Marker> at_rest, const BoardSettings& board);

}  // namespace ruffini
