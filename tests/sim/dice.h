// All chance of a simulation: integers alone, so that a seed gives the same on every machine (splitmix64).
#pragma once

#include <cstdint>

namespace ruffini::sim {

inline constexpr uint64_t kMillion = 1'000'000;

class Dice {
 public:
  explicit Dice(uint64_t seed) : state_(seed) {}
  // A stream of its own for each who draws: what one draws does not move the others.
  [[nodiscard]] Dice fork() { return Dice(next()); }

  uint64_t next() {
    uint64_t z = state_ += 0x9E37'79B9'7F4A'7C15;
    z = (z ^ z >> 30) * 0xBF58'476D'1CE4'E5B9;
    z = (z ^ z >> 27) * 0x94D0'49BB'1331'11EB;
    return z ^ z >> 31;
  }
  // 0 .. n - 1.
  uint64_t below(uint64_t n) { return next() % n; }
  uint64_t between(uint64_t low, uint64_t high) { return low + below(high - low + 1); }
  bool chance(uint64_t per_million) { return below(kMillion) < per_million; }

 private:
  uint64_t state_;
};

}  // namespace ruffini::sim
