// What a camera of libcamera is told before it starts.
#pragma once

#include <libcamera/libcamera.h>

#include "base/result.h"
#include "board/settings.h"

namespace ruffini {

// Adds a control by its name to `out`: names outlived the numbers from release to release. false: the camera has none.
bool ask(const libcamera::Camera& camera, const char* name, const libcamera::ControlValue& value,
         libcamera::ControlList& out);

// [exposure], but for white_kelvin, which libcamera has not (v4l2_exposure.h). Errors: kBadInput, with what the camera
// cannot be told.
[[nodiscard]] Status ask_exposure(const libcamera::Camera& camera, const ExposureSettings& exposure,
                                  libcamera::ControlList& out);

}  // namespace ruffini
