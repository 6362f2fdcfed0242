// Clock and random numbers from Linux.
#pragma once

#include <atomic>
#include <memory>
#include <string>

#include "base/clock.h"
#include "base/random.h"
#include "base/result.h"

namespace ruffini {

class SystemClock final : public Clock {
 public:
  [[nodiscard]] uint64_t now_us() const override;
};

// Time kept by another process in the first 8 bytes of a mapped file (microseconds, little endian): for tests that
// control the passage of time.
class FileClock final : public Clock {
 public:
  // Errors: kUnavailable (missing, unreadable, shorter than 8 bytes).
  [[nodiscard]] static Result<std::unique_ptr<Clock>> open(const std::string& path);
  ~FileClock() override;
  [[nodiscard]] uint64_t now_us() const override { return word_->load(std::memory_order_relaxed); }

 private:
  explicit FileClock(const std::atomic<uint64_t>* word) : word_(word) {}
  const std::atomic<uint64_t>* word_;
};

class SystemRandom final : public Random {
 public:
  // At boot, waits until the kernel has enough entropy.
  void fill(std::span<uint8_t> out) override;
};

}  // namespace ruffini
