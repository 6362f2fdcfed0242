// Two cameras as one: what both saw at the same moment, side by side, the first one's picture on the left.
//
// Frames belong together where their middles of exposure are at most a tolerance apart, those of recordings, which do not
// say when, where their numbers are the same. The pair's time is the mean of both, its number the left one's. A frame whose
// partner was lost is an invalid frame, and counted so. Cameras that never meet, or of which one ends, end the pair with a
// sentence: half a picture is no measurement.
#pragma once

#include <memory>

#include "capture/camera.h"

namespace ruffini {

// Size of the picture of the pair; each camera makes `width_px` / 2. Errors: kBadInput, where one is live and one is not.
[[nodiscard]] Result<std::unique_ptr<Camera>> pair_cameras(std::unique_ptr<Camera> left, std::unique_ptr<Camera> right,
                                                           int width_px, int height_px, uint64_t tolerance_us);

}  // namespace ruffini
