// Fixed-point numbers that carry their scale and unit in the type.
//
// Fixed<Rep, Frac, Unit> holds raw / 2^Frac of a unit. All code rounds half up, (x + 2^(n-1)) >> n, as NEON's VRSHR
// does. The only way back from a wide result is narrow<To>(), which saturates and counts each saturation.
#pragma once

#include <compare>
#include <cstdint>
#include <limits>

namespace ruffini {

// Number of values that were saturated. STATUS reports it, so that saturation is visible.
struct SaturationCounter {
  uint64_t count = 0;
};

// x / 2^shift, half up. Precondition: 1 <= shift <= 62 and |x| < 2^62.
[[nodiscard]] constexpr int64_t round_shift(int64_t x, int shift) { return (x + (int64_t{1} << (shift - 1))) >> shift; }

// Division that rounds towards minus infinity. Precondition: denominator > 0.
[[nodiscard]] constexpr int64_t floor_div(int64_t numerator, int64_t denominator) {
  const int64_t quotient = numerator / denominator;
  return quotient - ((numerator % denominator) < 0 ? 1 : 0);
}

template <typename Rep>
[[nodiscard]] constexpr Rep saturate_raw(int64_t x, SaturationCounter& counter) {
  constexpr int64_t kLow = std::numeric_limits<Rep>::min();
  constexpr int64_t kHigh = std::numeric_limits<Rep>::max();
  if (x < kLow || x > kHigh) {
    ++counter.count;
    return static_cast<Rep>(x < kLow ? kLow : kHigh);
  }
  return static_cast<Rep>(x);
}

template <typename RepT, int kFracBits, typename UnitT>
class Fixed {
 public:
  using Rep = RepT;
  static constexpr int kFrac = kFracBits;

  constexpr Fixed() = default;

  [[nodiscard]] static constexpr Fixed from_raw(Rep raw) {
    Fixed value;
    value.raw_ = raw;
    return value;
  }

  // For constants only: the conversion happens in the compiler, never on the board.
  [[nodiscard]] static consteval Fixed from_real(double real) {
    const double scaled = real * static_cast<double>(int64_t{1} << kFrac);
    return from_raw(static_cast<Rep>(scaled < 0 ? scaled - 0.5 : scaled + 0.5));
  }

  [[nodiscard]] constexpr Rep raw() const { return raw_; }
  constexpr auto operator<=>(const Fixed&) const = default;

 private:
  Rep raw_ = 0;
};

// Converts a wide raw value with kFrom fractional bits to To: rounds half up, saturates and counts.
template <typename To, int kFrom>
[[nodiscard]] constexpr To narrow(int64_t wide, SaturationCounter& counter) {
  static_assert(kFrom > To::kFrac && kFrom - To::kFrac <= 62);
  return To::from_raw(saturate_raw<typename To::Rep>(round_shift(wide, kFrom - To::kFrac), counter));
}

struct Ratio {};
struct Pixel {};
struct Micrometre {};

using RelativeChange = Fixed<int16_t, 12, Ratio>;      // I / I_rest - 1
using Slope = Fixed<int16_t, 12, Ratio>;               // dz/dx of the surface
using ImagePx = Fixed<int32_t, 16, Pixel>;             // image position or displacement
using DisplacementUm = Fixed<int16_t, 3, Micrometre>;  // 125 nm, +-4.096 mm
inline constexpr int kDisplacementLsbNm = 1000 >> 3;

}  // namespace ruffini
