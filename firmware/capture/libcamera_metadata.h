// Evaluates libcamera's metadata of a stream and of a frame.
#pragma once

#include <libcamera/libcamera.h>

#include <cstdint>
#include <optional>
#include <string>

#include "board/settings.h"
#include "capture/pixels.h"

namespace ruffini {

[[nodiscard]] YuvRule rule_of(const std::optional<libcamera::ColorSpace>& space);

// Exposure midpoint of the first row, in microseconds of CLOCK_MONOTONIC.
[[nodiscard]] uint64_t middle_us(const libcamera::ControlList& said, const libcamera::FrameMetadata& about);

// Describes how the frame's reported settings differ from [exposure]; settings that are not reported are not checked.
[[nodiscard]] std::string drift_of(const libcamera::ControlList& said, const ExposureSettings& asked);

}  // namespace ruffini
