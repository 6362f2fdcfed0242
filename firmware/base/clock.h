// Time as the device sees it: monotonic, from a zero that means nothing.
#pragma once

#include <cstdint>

namespace ruffini {

class Clock {
 public:
  Clock() = default;
  Clock(const Clock&) = delete;
  Clock& operator=(const Clock&) = delete;
  virtual ~Clock() = default;
  // Any thread.
  [[nodiscard]] virtual uint64_t now_us() const = 0;
};

}  // namespace ruffini
