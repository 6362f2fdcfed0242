// Quality of printed markers, estimated from each dot and its neighbours; clearly wrong markers are marked as lost.
//
//   quality = 255 / (1 + (e^2 + e_way^2) / 0.1^2), px; e of the dot itself (image/dot_templates.h)
//   e_way = max(|d - d'| - pitch / 4, 0), d' the nearest of the displacements extrapolated from pairs of neighbours
//
// A marker with an error above half a pixel is lost, because its neighbours predict it better. So is a marker whose dot
// has more than 1.75 times its area at rest, times the median growth of the known markers around it (at least 1; 1 if
// there are fewer than three): it is more than one dot.
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

// Sets the quality of `known` markers and removes lost ones from `known`; the quality of the others is 0.
void set_marker_quality(const MarkerGraph& graph, const DotAreas& areas, std::span<const int64_t> error2_q16,
                        int64_t pitch_q8, std::span<Marker> markers, std::span<uint8_t> known);

}  // namespace ruffini
