// Replaces libcamera_camera.cpp in builds without libcamera.
#include "capture/libcamera_camera.h"

namespace ruffini {

Result<std::unique_ptr<Camera>> open_libcamera(const std::string& name, const BoardSettings& /*board*/) {
  return Error{ErrorKind::kUnavailable, "--camera libcamera:" + name +
                                            ": this ruffinid was built without libcamera: install libcamera-dev (0.3 "
                                            "or newer: Debian 13, or bookworm-backports) and build it again"};
}

}  // namespace ruffini
