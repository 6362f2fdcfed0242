// Frames over a UNIX socket: of the live digital twin (`ruffini sim serve`), or of a recording that the host decodes
// (`ruffini live --camera VIDEO`).
//
// All numbers are little endian. The sender greets: "RFTC" (twin), "RFRC" (recording) or "RFRS" (simulated recording),
// version u32 = 1, width u32, height u32, rate u32 (millihertz), length u32 of the board's name, the name. The camera
// sends one byte when it needs its first frame: 'P' paced (the sender keeps its rate and skips frames that are
// late) or 'L' lockstep (every frame, as fast as it is taken; the time of a frame is its number times the period of the
// recording or, for a twin, of the board). Then each frame is: "RFTF", bytes u32, number u64 (gaps mean dropped
// frames), pixels B G R row by row. "RFTF" with 0 bytes is the end. For a board with light.alternation each frame is
// two: number 2 i with the lamps off, 2 i + 1 with them on.
#pragma once

#include <memory>
#include <string>

#include "base/clock.h"
#include "board/settings.h"
#include "capture/camera.h"

namespace ruffini {

// Expected sender. It decides the wording of messages only: the greeting tells twin and recording apart.
enum class FrameSender { kTwin, kRecording };

// Waits up to two seconds for the sender. `clock` must outlive the camera; paced frames use its time. Errors:
// kUnavailable (no server at the socket), kBadInput (not such a sender, another board, size or rate).
[[nodiscard]] Result<std::unique_ptr<Camera>> open_twin(FrameSender sender, const std::string& socket_path,
                                                        bool is_lockstep, const BoardSettings& board,
                                                        const Clock& clock);

}  // namespace ruffini
