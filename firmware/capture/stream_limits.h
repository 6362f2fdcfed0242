// Limits of a live stream, common to all kinds of cameras.
#pragma once

#include <algorithm>
#include <chrono>

namespace ruffini {

inline constexpr std::chrono::milliseconds kFrameWait{100};  // one wait; the daemon checks for its end in between
inline constexpr int kSettlingFrames = 10;  // after a start, until new controls take effect in every pipeline
inline constexpr int kMaxDrifted = 300;     // consecutive frames whose settings differ from [exposure]
inline constexpr int kMaxDamaged = 300;     // consecutive frames that are truncated or marked as damaged
inline constexpr int kMaxRestarts = 3;      // consecutive restarts without a frame

// Time without frames after which a stream is restarted: a second, or three periods of a slow camera. It doubles after
// each start that gave no frame: some cameras take seconds to their first frame, and restarting within that time would
// postpone it forever.
[[nodiscard]] constexpr std::chrono::nanoseconds longest_silence(std::chrono::nanoseconds period, int n_vain_starts) {
  return std::max<std::chrono::nanoseconds>(std::chrono::seconds{1}, 3 * period) * (1 << n_vain_starts);
}

}  // namespace ruffini
