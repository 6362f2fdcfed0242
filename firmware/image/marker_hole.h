// Where the coating of a pad is torn off, or hidden, its light means no depth; printed markers tell by going together.
//
//   bad: lost, or of a quality below 40 (0.23 px off), and expected more than half a pitch inside the picture
//   hole: four bad markers among 3 x 3 of the lattice, without those on its border
//
// Presses on the twin up to 1.2 mm deep and sheared by 0.5 mm make at most two, the recorded video of a real pad sheared
// by two pitches three. Single markers under dirt are filled from their neighbours, and do no harm. For lattices of
// printed markers in one view. Frame thread; no allocation. Not in the papers.
#pragma once

#include <span>

#include "image/markers.h"

namespace ruffini {

// `markers`: size.count() of them, by rows.
[[nodiscard]] bool has_hole(std::span<const Marker> markers, GridSize size, int width_px, int height_px);

}  // namespace ruffini
