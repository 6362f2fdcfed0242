// A camera of whose frames every second one is taken with the lamps off: gives what the lamps alone make.
//
// A lit frame less the dark one whose number is one below is a frame; its time is the lit one's, its number half of that
// one's. A frame whose partner was lost, or during which the lamps were switched, is an invalid frame and counted so.
// What the pad does between the two exposures is in the difference where daylight has edges: half a frame of motion.
#pragma once

#include <functional>
#include <memory>

#include "capture/camera.h"

namespace ruffini {

enum class Lamps { kLit, kDark, kNotKnown };

// What the lamps did while a frame was taken.
using LampsDuring = std::function<Lamps(const FramePool::Buffer& frame)>;

// Of a camera whose odd frames are lit: a twin's.
[[nodiscard]] Lamps lamps_by_number(const FramePool::Buffer& frame);

// `n_bytes` of a picture. A camera that never gives a pair ends with a sentence.
[[nodiscard]] std::unique_ptr<Camera> alternate(std::unique_ptr<Camera> camera, LampsDuring lamps, size_t n_bytes);

}  // namespace ruffini
