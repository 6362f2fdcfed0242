// Combines lit and dark frames of a camera: gives the light of the lamps alone.
//
// A result is a lit frame minus the dark frame with the preceding number. Its time is that of the lit frame, its number
// half of that frame's. A frame without its partner, or one during which the lamps were switched, is an invalid frame
// and is counted. Motion between the two exposures, half a frame period, remains visible at edges of ambient light.
#pragma once

#include <functional>
#include <memory>

#include "capture/camera.h"

namespace ruffini {

enum class Lamps { kLit, kDark, kNotKnown };

// Returns the state of the lamps while a frame was taken.
using LampsDuring = std::function<Lamps(const FramePool::Buffer& frame)>;

// For a camera whose odd frames are lit, such as a twin.
[[nodiscard]] Lamps lamps_by_number(const FramePool::Buffer& frame);

// `n_bytes`: size of a picture. A camera that never gives a pair ends with an error message.
[[nodiscard]] std::unique_ptr<Camera> alternate(std::unique_ptr<Camera> camera, LampsDuring lamps, size_t n_bytes);

}  // namespace ruffini
