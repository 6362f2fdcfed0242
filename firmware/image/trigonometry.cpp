#include "image/trigonometry.h"

#include <algorithm>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int64_t kPiQ60 = 3'622'009'729'038'561'421;  // pi 2^60, rounded

// Product of two Q40 numbers below 2^42, without leaving 64 bits: b split in 20-bit halves.
int64_t mul_q40(int64_t a, int64_t b) {
  const int64_t high = b >> 20;
  const int64_t low = b & ((int64_t{1} << 20) - 1);
  return (a * high + (a * low >> 20)) >> 20;
}

// Taylor series on [0, pi/4], angle in Q40: terms fall below 2^-40 after the tenth.
int64_t series_q40(int64_t angle, bool is_sine) {
  const int64_t square = mul_q40(angle, angle);
  int64_t term = is_sine ? angle : int64_t{1} << 40;
  int64_t sum = term;
  for (int64_t k = is_sine ? 2 : 1; k < 20; k += 2) {
    term = -mul_q40(term, square) / (k * (k + 1));
    sum += term;
  }
  return sum;
}

}  // namespace

int32_t cos_pi_q30(int64_t numerator, int64_t denominator) {
  int64_t n = numerator % (2 * denominator);
  n = n < 0 ? n + 2 * denominator : n;
  if (n > denominator) n = 2 * denominator - n;      // cos is even about pi
  const bool is_negative = 2 * n > denominator;      // second quadrant
  if (is_negative) n = denominator - n;
  const bool is_sine = 4 * n > denominator;          // beyond pi / 4: cos x = sin(pi/2 - x)
  // angle = pi n / denominator or pi (denominator - 2 n) / (2 denominator), Q40 via two divisions.
  const int64_t top = is_sine ? denominator - 2 * n : n;
  const int64_t bottom = is_sine ? 2 * denominator : denominator;
  const int64_t fraction_q40 = (top << 30) / bottom * 1024 + (((top << 30) % bottom) << 10) / bottom;
  const int64_t value = series_q40(mul_q40(kPiQ60 >> 20, fraction_q40), is_sine);
  const int64_t rounded = std::min<int64_t>(round_shift(value, 10), int64_t{1} << 30);
  return static_cast<int32_t>(is_negative ? -rounded : rounded);
}

uint64_t integer_sqrt(uint64_t x) {
  uint64_t root = 0;
  for (uint64_t bit = uint64_t{1} << 31; bit != 0; bit >>= 1) {
    const uint64_t next = root | bit;
    if (next <= x / next) root = next;
  }
  return root;
}

}  // namespace ruffini
