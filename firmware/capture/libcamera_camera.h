// A camera of the Linux board or on USB, through libcamera 0.3 or newer. Only its .cpp files depend on libcamera.
//
// Frames have the board's size and rate; frames of a camera with a fixed rate are selected at the board's. With
// [exposure] of board.toml the camera's automatics are off, and frames whose metadata report another exposure, gain or
// colour are invalid (kInvalidFrame); a USB camera has no such metadata and is queried each second. After a second
// without frames (stream_limits.h) the stream is restarted. Unrecoverable errors end the stream (kEnd, problem()): the
// camera was unplugged, cannot be stopped, or does not keep what [exposure] demands.
#pragma once

#include <memory>
#include <string>

#include "board/settings.h"
#include "capture/camera.h"

namespace ruffini {

// `name`: a substring of the camera's id; empty if there is only one. Errors: kUnavailable (none, in use, or built
// without libcamera), kBadInput (several, or none of its modes fits the board).
[[nodiscard]] Result<std::unique_ptr<Camera>> open_libcamera(const std::string& name, const BoardSettings& board);

}  // namespace ruffini
