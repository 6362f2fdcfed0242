// Recorded frames as a camera: a video file, or a folder of images (sorted by name; `frames/` inside it
// where there is one), with an optional recording.toml: simulated, rate_mhz, board.
#pragma once

#include <chrono>
#include <memory>
#include <string>

#include "board/settings.h"
#include "capture/camera.h"

namespace ruffini {

struct ReplayOptions {
  std::string path;
  bool is_lockstep = false;  // hand over every frame as soon as it is wanted
  bool is_loop = false;
};

// Errors: kUnavailable (missing, unreadable, empty), kBadInput (wrong size, recording of another board).
[[nodiscard]] Result<std::unique_ptr<Camera>> open_replay(const ReplayOptions& options, const BoardSettings& board);

}  // namespace ruffini
