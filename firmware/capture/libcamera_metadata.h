// What libcamera says of a stream and of a frame.
#pragma once

#include <libcamera/libcamera.h>

#include <cstdint>
#include <optional>
#include <string>

#include "board/settings.h"
#include "capture/pixels.h"

namespace ruffini {

[[nodiscard]] YuvRule rule_of(const std::optional<libcamera::ColorSpace>& space);

// The middle of the first row's exposure, in microseconds of CLOCK_MONOTONIC.
[[nodiscard]] uint64_t middle_us(const libcamera::ControlList& said, const libcamera::FrameMetadata& about);

// What the frame was really taken with, where that is not what [exposure] asks; what is not told is not judged.
[[nodiscard]] std::string drift_of(const libcamera::ControlList& said, const ExposureSettings& asked);

}  // namespace ruffini
