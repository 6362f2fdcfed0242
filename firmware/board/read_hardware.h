// The sections of a board.toml about what is round the sensor; each may be left out.
#pragma once

#include "board/reader.h"
#include "board/settings.h"

namespace ruffini {

// After [camera].
void read_hardware(BoardReader& in, BoardSettings& board);

}  // namespace ruffini
