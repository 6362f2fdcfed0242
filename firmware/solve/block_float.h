// Vectors of wide integers as 16 bits with one common power of two: v = v16 2^shift, rounded half up.
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>
#include <span>

#include "base/fixed.h"

namespace ruffini::block_float {

[[nodiscard]] constexpr int bit_width(int64_t x) { return static_cast<int>(std::bit_width(static_cast<uint64_t>(x))); }

// The smallest shift with which values up to `largest` >= 0 stay within +-32767, rounding included.
[[nodiscard]] constexpr int shift_for(int64_t largest) {
  return std::max(bit_width(largest + (largest >> 14)) - 15, 0);
}

[[nodiscard]] inline int common_shift(std::span<const int64_t> values) {
  int64_t largest = 0;
  for (const int64_t v : values) largest = std::max(largest, v < 0 ? -v : v);
  return shift_for(largest);
}

[[nodiscard]] constexpr int64_t to_16(int64_t v, int shift) { return shift == 0 ? v : round_shift(v, shift); }

}  // namespace ruffini::block_float
