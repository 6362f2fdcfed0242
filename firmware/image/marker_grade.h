// How sure a printed marker is, from its dot and its neighbours; what is surely wrong is lost.
//
//   quality = 255 / (1 + (e^2 + e_way^2) / 0.1^2), px; e of the dot itself (image/dot_templates.h)
//   e_way = max(|d - d'| - pitch / 4, 0), d' the nearest of what the lines through two neighbours say
//
// At more than half a pixel the marker is lost: its neighbours know better. So is one whose dot has more than 1.75 times
// the area that it had at rest, times the median growth (1 at least, and with fewer than three) of the known ones around:
// it is more than one dot.
// Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>

#include "image/marker_graph.h"
#include "image/markers.h"

namespace ruffini {

struct DotAreas {
  std::span<const int> now;  // px, of known markers
  std::span<const int> rest;
};

// Sets quality of `known` markers and takes those that are lost out of it; the others' quality is 0.
void grade_markers(const MarkerGraph& graph, const DotAreas& areas, std::span<const int64_t> error2_q16,
                   int64_t pitch_q8, std::span<Marker> markers, std::span<uint8_t> known);

}  // namespace ruffini
