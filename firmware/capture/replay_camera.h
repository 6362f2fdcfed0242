// Recorded frames as a camera: a video file, or a folder of images (sorted by name; `frames/` inside it
// where there is one), with an optional recording.toml: simulated, rate_mhz, board.
#pragma once

#include <memory>
#include <string>

#include "base/clock.h"
#include "board/settings.h"
#include "capture/camera.h"

namespace ruffini {

struct ReplayOptions {
  std::string path;
  bool is_lockstep = false;  // hand over every frame as soon as it is wanted
  bool is_loop = false;
};

// `clock` outlives the camera; its pace and its stamps are of that time.
// Errors: kUnavailable (missing, unreadable, empty), kBadInput (wrong size, recording of another board).
[[nodiscard]] Result<std::unique_ptr<Camera>> open_replay(const ReplayOptions& options, const BoardSettings& board,
                                                          const Clock& clock);

}  // namespace ruffini
