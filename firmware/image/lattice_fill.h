// Markers without a displacement of their own take their lattice neighbours'.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "image/markers.h"

namespace ruffini {

// Mean displacement, Q16 px, rounded down, of those of a marker's 8 neighbours that `known` holds; how many, 0 = none.
int neighbour_mean(std::span<const Marker> markers, GridSize size, std::span<const uint8_t> known, int index,
                   int64_t& mean_x, int64_t& mean_y);

// Nearest ring first: a marker that is not known takes the mean of those of its 8 neighbours that are, rounded down, and
// is known in the next round. `known` ends as all ones if any was; `next` is work space of the same size.
void fill_from_neighbours(std::span<Marker> markers, GridSize size, std::vector<uint8_t>& known,
                          std::vector<uint8_t>& next);

}  // namespace ruffini
