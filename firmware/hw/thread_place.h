// Where a thread runs, and what it goes before: [threads] of board.toml.
#pragma once

#include <string>

#include "board/hardware_settings.h"

namespace ruffini {

// For the calling thread. What cannot be had is left as it is: returns sentences that say what and the remedy; empty
// where all is as asked. A thread of SCHED_FIFO may be given less without any right, more with RLIMIT_RTPRIO.
[[nodiscard]] std::string place_thread(const std::string& role, const ThreadSettings& wanted);

// What the calling thread has, e.g. "FIFO 45 on CPU 2,3".
[[nodiscard]] std::string thread_placed();

}  // namespace ruffini
