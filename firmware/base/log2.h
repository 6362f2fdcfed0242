// Logarithm of an integer, without floating point.
#pragma once

#include <bit>
#include <cstdint>

namespace ruffini {

// log2 of x in 1/65536, rounded down. Precondition: x > 0.
[[nodiscard]] constexpr int64_t log2_q16(uint64_t x) {
  constexpr int kMantissa = 30;
  const int whole = static_cast<int>(std::bit_width(x)) - 1;
  uint64_t mantissa = whole > kMantissa ? x >> (whole - kMantissa) : x << (kMantissa - whole);  // 1 to 2
  int64_t out = whole;
  for (int bit = 0; bit < 16; ++bit) {
    mantissa = (mantissa * mantissa) >> kMantissa;
    const uint64_t is_above = mantissa >> (kMantissa + 1);
    mantissa >>= is_above;
    out = 2 * out + static_cast<int64_t>(is_above);
  }
  return out;
}

}  // namespace ruffini
