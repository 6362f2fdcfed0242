// Whether the markers found at rest stand as far apart as the board says: another pad, resolution or standoff would
// give displacements in a wrong scale, and nothing else would tell.
//
//   k = sum e . p / sum e . e        p: places at rest, e: nominal ones (px), each from its mean
//
// True while |k - 1| <= 15 %, and where there is nothing to compare: fewer than 8 markers, or places that board.toml does
// not list. Not in the papers.
#pragma once

#include <span>

#include "board/settings.h"
#include "image/markers.h"

namespace ruffini {

[[nodiscard]] bool pitch_fits(std::span<const Marker> at_rest, const BoardSettings& board);

}  // namespace ruffini
