#include "image/trigonometry.h"

namespace ruffini {
namespace {

constexpr uint64_t kPiQ60 = 3'622'009'729'038'561'421;  // pi 2^60, rounded

// Returns a b / 2^60 of two non-negative Q60 numbers up to pi, rounded down, within 64 bits.
uint64_t mul_q60(uint64_t a, uint64_t b) {
  constexpr uint64_t kLowHalf = 0xFFFF'FFFF;
  const uint64_t a_high = a >> 32;
  const uint64_t b_high = b >> 32;
  const uint64_t middle = a_high * (b & kLowHalf) + (a & kLowHalf) * b_high + ((a & kLowHalf) * (b & kLowHalf) >> 32);
  return (a_high * b_high << 4) + (middle >> 28);
}

// Returns top / bottom in Q60, rounded down. Precondition: top < bottom < 2^32.
uint64_t ratio_q60(uint64_t top, uint64_t bottom) {
  const uint64_t high = (top << 30) / bottom;
  const uint64_t rest = (top << 30) % bottom;
  return (high << 30) + (rest << 30) / bottom;
}

// Taylor series on [0, pi/4], all Q60: sin = x - x^3/3! + ..., cos = 1 - x^2/2! + ...
uint64_t series_q60(uint64_t angle, bool is_sine) {
  const uint64_t square = mul_q60(angle, angle);
  uint64_t term = is_sine ? angle : uint64_t{1} << 60;
  uint64_t sum = term;
  bool is_minus = true;
  for (uint64_t k = is_sine ? 2 : 1; term != 0; k += 2) {
    term = mul_q60(term, square) / (k * (k + 1));
    sum = is_minus ? sum - term : sum + term;
    is_minus = !is_minus;
  }
  return sum;
}

}  // namespace

int32_t cos_pi_q30(int64_t numerator, int64_t denominator) {
  int64_t n = numerator % (2 * denominator);
  n = n < 0 ? n + 2 * denominator : n;
  if (n > denominator) n = 2 * denominator - n;  // cos is even about pi
  const bool is_negative = 2 * n > denominator;  // second quadrant
  if (is_negative) n = denominator - n;
  const bool is_sine = 4 * n > denominator;  // beyond pi / 4: cos x = sin(pi/2 - x)
  // angle = pi n / denominator or pi (denominator - 2 n) / (2 denominator)
  const auto top = static_cast<uint64_t>(is_sine ? denominator - 2 * n : n);
  const auto bottom = static_cast<uint64_t>(is_sine ? 2 * denominator : denominator);
  const uint64_t value = series_q60(mul_q60(kPiQ60, ratio_q60(top, bottom)), is_sine);
  const auto rounded = static_cast<int32_t>((value + (uint64_t{1} << 29)) >> 30);
  return is_negative ? -rounded : rounded;
}

}  // namespace ruffini
