// Source of unpredictable bytes.
#pragma once

#include <cstdint>
#include <span>

namespace ruffini {

class Random {
 public:
  Random() = default;
  Random(const Random&) = delete;
  Random& operator=(const Random&) = delete;
  virtual ~Random() = default;
  virtual void fill(std::span<uint8_t> out) = 0;
};

}  // namespace ruffini
