// Limits of a live stream, the same for every kind of camera.
#pragma once

#include <algorithm>
#include <chrono>

namespace ruffini {

inline constexpr std::chrono::milliseconds kFrameWait{100};  // one wait; then the daemon looks whether it is to stop
inline constexpr int kSettlingFrames = 10;  // after a start, until new controls are in force in every pipeline
inline constexpr int kMaxDrifted = 300;     // frames in a row that are not as [exposure] asks
inline constexpr int kMaxDamaged = 300;     // frames in a row that are cut short or marked as damaged
inline constexpr int kMaxRestarts = 3;      // in a row, without a frame between

// How long a camera may be silent before its stream is started again: a second, or three periods of a slow camera;
// after each start that gave no frame twice as long as before it: some cameras take seconds to their first one, and a
// start in that time would put it off for ever.
[[nodiscard]] constexpr std::chrono::nanoseconds longest_silence(std::chrono::nanoseconds period, int n_vain_starts) {
  return std::max<std::chrono::nanoseconds>(std::chrono::seconds{1}, 3 * period) * (1 << n_vain_starts);
}

}  // namespace ruffini
