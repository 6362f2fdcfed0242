// Detects torn or hidden coating, where light does not indicate depth, by printed markers that are lost together.
//
//   bad: lost, or of a quality below 40 (0.23 px off), while expected more than half a pitch inside the picture
//   hole: bad markers close together, not counting the lattice's border, by the smaller of its pitches:
//           below kNarrowPitchUm    10 within 5 x 5: edges of deep faces hide a line of dots, at most 7 of 5 x 5
//           from there on           4 within 3 x 3
//           from kWidePitchUm on    also two lost neighbours along an axis
//
// Presses on the twin up to 1.2 mm deep and sheared by 0.5 mm cause at most two bad markers within 3 x 3 at pitches of
// 1 and 2 mm, the recorded video of a real pad (2 mm) sheared by two pitches three, and no two lost neighbours. A hole
// of 3.3 mm, darker or brighter than the gel, is found at least a pitch and 1 mm inside the outermost markers
// (test_torn_coating.py; painted into the video, test_marker_video.py). Limit: one of the gel's own grey, centred on a
// marker of a wide lattice, hides that one alone. Single markers under dirt are harmless, as neighbours fill them;
// two side by side make a wide lattice invalid. For lattices of printed markers in one view, narrow ones of 7 x 7 and
// more. Frame thread; no allocation. Not in the papers.
#pragma once

#include <cstdint>
#include <span>

#include "board/settings.h"
#include "image/markers.h"

namespace ruffini {

inline constexpr int64_t kNarrowPitchUm = 750;
inline constexpr int64_t kWidePitchUm = 1'400;

// `markers`: those of the board's lattice, row by row.
[[nodiscard]] bool has_hole(std::span<const Marker> markers, const MarkerSettings& settings, int width_px,
                            int height_px);

}  // namespace ruffini
