// Checks that combinations of keys in board.toml are consistent.
#pragma once

#include "board/reader.h"
#include "board/settings.h"

namespace ruffini {

// Reports the first inconsistency to `in`.
void cross_check(BoardReader& in, const BoardSettings& board);

}  // namespace ruffini
