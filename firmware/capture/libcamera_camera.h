// A camera of the Linux board, or one on USB, through libcamera 0.3 or newer. All that knows libcamera is in its .cpp.
//
// Frames are of the board's size, at its rate; where the camera has no rate of its own they are taken at the board's.
// With [exposure] of board.toml its automatics are off, and frames whose metadata say another exposure, gain or colour
// are no frames (kInvalidFrame); one on USB has no such metadata and is asked each second. Without frames for a second
// (stream_limits.h) the stream is started again. What cannot be mended ends the stream (kEnd, problem()): the camera is gone, cannot be
// stopped, or does not keep what [exposure] asks.
#pragma once

#include <memory>
#include <string>

#include "board/settings.h"
#include "capture/camera.h"

namespace ruffini {

// `name`: a part of the camera's id; empty where there is only one. Errors: kUnavailable (none, in use, or built without
// libcamera), kBadInput (several, or none of its modes is the board's).
[[nodiscard]] Result<std::unique_ptr<Camera>> open_libcamera(const std::string& name, const BoardSettings& board);

}  // namespace ruffini
