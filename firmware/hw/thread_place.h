// Scheduling priority and CPU affinity of a thread: [threads] of board.toml.
#pragma once

#include <cstdint>
#include <string>

#include "board/hardware_settings.h"

namespace ruffini {

// Applies to the calling thread. A setting that is not permitted is left unchanged; the returned sentences state which,
// and the remedy. Empty: everything was applied. A SCHED_FIFO thread may lower its priority without privileges, and
// raise it with RLIMIT_RTPRIO.
[[nodiscard]] std::string place_thread(const std::string& role, const ThreadSettings& wanted);

// Current placement of the calling thread.
struct ThreadPlace {
  uint32_t priority = 0;  // real-time; 0: none
  uint64_t cpus = 0;      // mask; 0: all that are online
};
[[nodiscard]] ThreadPlace thread_place();
// The same in words, e.g. "FIFO 45 on CPU 2,3".
[[nodiscard]] std::string thread_placement();

}  // namespace ruffini
