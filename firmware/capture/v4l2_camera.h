// A camera of Linux through V4L2 itself: those on USB (UVC), on every kernel since 5.10, without libcamera.
//
// Frames are of the board's size, in the first of v4l2_formats() that gives it at the board's rate and starts; from a
// camera that is faster they are taken at the board's. With [exposure] of board.toml its automatics are off; it is asked
// each second, and frames taken while it says another exposure, gain or white are no frames (kInvalidFrame), nor are
// those that the driver marks as damaged or that are cut short. Without frames for a while (stream_limits.h) the stream
// is started again. What cannot be mended ends the stream (kEnd, problem()): the camera is gone, changed its picture,
// stays silent, gives damaged frames only, or does not keep what [exposure] asks.
//
//   capture_us  the driver's monotonic stamp; of the start of exposure: + exposure / 2, of the end of the frame:
//               - exposure / 2, where [exposure] gives it. 0 where the driver's clock is another
//   number      counts the driver's sequence, so gaps are frames lost in the driver
#pragma once

#include <memory>
#include <string>

#include "board/settings.h"
#include "capture/camera.h"
#include "capture/video_calls.h"

namespace ruffini {

// `name`: the path of its node, a part of its name, its serial number on USB or that identity as VVVV:PPPP; empty where
// there is only one. Errors: kUnavailable (none, in use, not allowed), kBadInput (several, no camera, or none of its
// modes is the board's).
[[nodiscard]] Result<std::unique_ptr<Camera>> open_v4l2(const std::string& name, const BoardSettings& board,
                                                        VideoCalls calls = VideoCalls::of_kernel());

}  // namespace ruffini
