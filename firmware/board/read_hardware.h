// Reads the sections of board.toml about the hardware around the sensor; all are optional.
#pragma once

#include "board/reader.h"
#include "board/settings.h"

namespace ruffini {

// Call after [camera] was read.
void read_hardware(BoardReader& in, BoardSettings& board);

}  // namespace ruffini
