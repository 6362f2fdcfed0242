// What no single key of a board.toml can tell.
#pragma once

#include "board/reader.h"
#include "board/settings.h"

namespace ruffini {

// Fails `in` with the first thing that does not fit together.
void cross_check(BoardReader& in, const BoardSettings& board);

}  // namespace ruffini
