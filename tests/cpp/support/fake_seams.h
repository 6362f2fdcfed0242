// A clock that stands still until it is told, and random numbers that everybody can foresee.
#pragma once

#include "base/clock.h"
#include "base/random.h"

namespace ruffini::test {

class FakeClock final : public Clock {
 public:
  [[nodiscard]] uint64_t now_us() const override { return us; }
  uint64_t us = 1'000'000;  // NOLINT(misc-non-private-member-variables-in-classes)
};

class FakeRandom final : public Random {
 public:
  void fill(std::span<uint8_t> out) override {
    for (uint8_t& byte : out) byte = ++last_;
  }

 private:
  uint8_t last_ = 0;
};

}  // namespace ruffini::test
