// How long a camera may be silent before its stream is started again.
#pragma once

#include <algorithm>
#include <chrono>

namespace ruffini {

// A second, or three periods of a slow camera; after each start that gave no frame twice as long as before it: some
// cameras take seconds to their first one, and a start in that time would put it off for ever.
[[nodiscard]] constexpr std::chrono::nanoseconds longest_silence(std::chrono::nanoseconds period, int n_vain_starts) {
  return std::max<std::chrono::nanoseconds>(std::chrono::seconds{1}, 3 * period) * (1 << n_vain_starts);
}

}  // namespace ruffini
