// Two cameras as one: simultaneous pictures side by side, the first camera's on the left.
//
// Frames form a pair if their exposure midpoints are at most a tolerance apart; frames of recordings, which have no
// times, if their numbers are equal. The pair's time is the mean of both, its number that of the left frame. A frame
// without partner is an invalid frame and is counted. If the cameras never form pairs, or one of them ends, the pair
// ends with an error message: half a picture is not a measurement.
#pragma once

#include <memory>

#include "capture/camera.h"

namespace ruffini {

// Size of the joint picture; each camera gives `width_px` / 2. Errors: kBadInput if only one of them is live.
[[nodiscard]] Result<std::unique_ptr<Camera>> pair_cameras(std::unique_ptr<Camera> left, std::unique_ptr<Camera> right,
                                                           int width_px, int height_px, uint64_t tolerance_us);

}  // namespace ruffini
