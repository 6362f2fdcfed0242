// Clock and randomness of Linux.
#pragma once

#include "base/clock.h"
#include "base/random.h"

namespace ruffini {

class SystemClock final : public Clock {
 public:
  [[nodiscard]] uint64_t now_us() const override;
};

class SystemRandom final : public Random {
 public:
  // Waits at boot until the kernel has enough of it.
  void fill(std::span<uint8_t> out) override;
};

}  // namespace ruffini
