// Frames over a UNIX socket: of the live digital twin (`ruffini sim serve`), or of a recording that the host's tools decode
// (`ruffini live --camera VIDEO`).
//
// Everything little endian. The other side greets: "RFTC" of a twin "RFRC" of a recording, or "RFRS" of a simulated recording; version u32 = 1, width u32, height u32, rate u32 (millihertz),
// length u32 of the board's name, the name. The camera answers one byte when its first frame is wanted: 'P' paced (the
// twin keeps the board's rate and skips what it is late for) or 'L' lockstep (every frame, as fast as it is taken; the
// time of a frame is its number times the board's period, whenever it comes).
// Then, for each frame: "RFTF", bytes u32, number u64 (gaps mean drops), pixels B G R row by row.
// "RFTF" with 0 bytes is the end. Of a board with light.alternation each frame is two: number 2 i with the lamps off, 2 i + 1
// with them on.
#pragma once

#include <memory>
#include <string>

#include "base/clock.h"
#include "board/settings.h"
#include "capture/camera.h"

namespace ruffini {

// Waits up to two seconds for the twin. `clock` outlives the camera; paced frames have its time. Errors: kUnavailable (nobody serves there), kBadInput (no twin, another board,
// another size).
[[nodiscard]] Result<std::unique_ptr<Camera>> open_twin(const std::string& socket_path, bool is_lockstep,
                                                        const BoardSettings& board, const Clock& clock);

}  // namespace ruffini
