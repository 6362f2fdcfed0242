// Sets the controls of a libcamera camera before it starts.
#pragma once

#include <libcamera/libcamera.h>

#include "base/result.h"
#include "board/settings.h"

namespace ruffini {

// Adds a control by name to `out`, because numbers change between releases and names do not. Returns false if the
// camera does not have it.
bool add_control(const libcamera::Camera& camera, const char* name, const libcamera::ControlValue& value,
                 libcamera::ControlList& out);

// Adds [exposure], except white_kelvin, which libcamera does not support (v4l2_exposure.h). Returns kBadInput with the
// values that the camera does not accept.
[[nodiscard]] Status add_exposure_controls(const libcamera::Camera& camera, const ExposureSettings& exposure,
                                           libcamera::ControlList& out);

}  // namespace ruffini
