// Block floating point: wide integers as 16 bits with one common power of two, v = v16 2^shift, rounded half up.
// Quotients are a mantissa and an exponent.
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>
#include <span>

#include "base/fixed.h"

namespace ruffini::block_float {

[[nodiscard]] constexpr int bit_width(int64_t x) { return static_cast<int>(std::bit_width(static_cast<uint64_t>(x))); }

// Returns the smallest shift that keeps values up to `largest` >= 0 within +-32767 after rounding.
[[nodiscard]] constexpr int shift_for(int64_t largest) {
  return std::max(bit_width(largest + (largest >> 14)) - 15, 0);
}

inline constexpr int64_t kLimit = (int64_t{1} << 31) - 1;
inline constexpr int64_t kWideLimit = int64_t{1} << 62;

inline int64_t clamp_counted(int64_t x, SaturationCounter& saturations, int64_t limit = kLimit) {
  if (x < -limit || x > limit) {
    ++saturations.count;
    return x < 0 ? -limit : limit;
  }
  return x;
}

// Rounding shift in either direction, saturated at +-2^62. Returns zero if all bits are shifted out.
inline int64_t shift_saturating(int64_t x, int right) {
  if (right > 0) return right > 62 ? 0 : round_shift(x, right);
  if (x == 0) return 0;
  const int64_t room = right < -62 ? 0 : kWideLimit >> -right;
  if (x > room || x < -room) return x < 0 ? -kWideLimit : kWideLimit;
  return x * (int64_t{1} << -right);
}

[[nodiscard]] inline int common_shift(std::span<const int64_t> values) {
  int64_t largest = 0;
  for (const int64_t v : values) largest = std::max(largest, v < 0 ? -v : v);
  return shift_for(largest);
}

[[nodiscard]] constexpr int64_t to_16(int64_t v, int shift) { return shift == 0 ? v : round_shift(v, shift); }

// mantissa 2^exponent, with the mantissa below 2^24.
struct Quotient {
  int64_t mantissa = 0;
  int exponent = 0;
};

// Returns numerator 2^exponent / denominator. Precondition: both are positive.
inline Quotient quotient(int64_t numerator, int64_t denominator, int exponent) {
  const int up = 62 - bit_width(numerator);
  const int down = std::max(bit_width(denominator) - 38, 0);
  // numerator 2^up has 62 bits and denominator 2^-down at most 38, so the quotient has at least 24 bits.
  int64_t mantissa = (numerator << up) / (denominator >> down);
  const int extra = std::max(bit_width(mantissa) - 24, 0);
  mantissa >>= extra;
  return {mantissa, exponent - up - down + extra};
}

// Returns value quotient 2^exponent, rounded. Precondition: |value| < 2^38.
inline int64_t scaled(int64_t value, const Quotient& quotient, int exponent) {
  return shift_saturating(value * quotient.mantissa, -(quotient.exponent + exponent));
}

}  // namespace ruffini::block_float
