// A Linux camera through V4L2 itself, such as a USB (UVC) camera; works with every kernel since 5.10, without
// libcamera.
//
// Frames have the board's size, in the first of v4l2_formats() that provides it at the board's rate and starts; frames
// of a faster camera are selected at the board's rate. With [exposure] of board.toml the camera's automatics are off;
// it is queried each second, and frames taken while it reports another exposure, gain or white balance are invalid
// (kInvalidFrame), as are truncated frames and those that the driver marks as damaged. Without frames for a while
// (stream_limits.h) the stream is restarted. Unrecoverable errors end the stream (kEnd, problem()): the camera was
// unplugged, changed its picture format, stays silent, gives damaged frames only, or does not keep what [exposure]
// demands.
//
//   capture_us  the driver's monotonic stamp, converted to mid-exposure if [exposure] is given: + exposure / 2 if it
//               marks the start of exposure, - exposure / 2 if the end of the frame. 0 if the driver uses another clock
//   number      follows the driver's sequence, so gaps are frames lost in the driver
#pragma once

#include <memory>
#include <string>

#include "board/settings.h"
#include "capture/camera.h"
#include "capture/video_calls.h"

namespace ruffini {

// `name`: the path of its node, a substring of its name, its USB serial number, or its USB identity as VVVV:PPPP; empty
// if there is only one. Errors: kUnavailable (none, in use, not permitted), kBadInput (several, not a camera, or none
// of its modes fits the board).
[[nodiscard]] Result<std::unique_ptr<Camera>> open_v4l2(const std::string& name, const BoardSettings& board,
                                                        VideoCalls calls = VideoCalls::of_kernel());

}  // namespace ruffini
