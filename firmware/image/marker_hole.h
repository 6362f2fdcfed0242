// Detects torn or hidden coating, where light does not indicate depth, by printed markers that are lost together.
//
//   bad: lost, or of a quality below 40 (0.23 px off), while expected more than half a pitch inside the picture
//   hole: four bad markers within 3 x 3 of the lattice, not counting its border
//
// Presses on the twin up to 1.2 mm deep and sheared by 0.5 mm cause at most two, the recorded video of a real pad
// sheared by two pitches three. Single markers under dirt are harmless: their neighbours fill them. For lattices of
// printed markers in one view. Frame thread; no allocation. Not in the papers.
#pragma once

#include <span>

#include "image/markers.h"

namespace ruffini {

// `markers`: size.count() of them, row by row.
[[nodiscard]] bool has_hole(std::span<const Marker> markers, GridSize size, int width_px, int height_px);

}  // namespace ruffini
