// Monotonic time of the device; the origin is arbitrary.
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
