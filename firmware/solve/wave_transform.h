// Fields on a rectangular grid as waves along x and y, and back, in 16-bit block floating point.
//
//   to_waves:  W = Y f X^T     to_places: f = Y^T W X     Y, X: tables of cosines or sines, waves x places
//
// Each is two matrix products of 16-bit numbers with 32-bit sums. Before every product the components that
// travel together are rounded to 14 bits and sign with one common shift; a table's entries are at most 2^kFraction
// and a sum has at most kMaxTerms of them: 2^14 2^11 63 < 2^31, so nothing overflows.
// Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace ruffini {

// One axis: waves x places, and the same transposed.
struct WaveTable {
  // Precondition: entries.size() == n_waves * n_places, none beyond +-2^WaveTransform::kFraction.
  WaveTable(std::span<const int16_t> entries, int n_waves, int n_places);

  int n_waves;
  int n_places;
  std::vector<int16_t> by_wave;
  std::vector<int16_t> by_place;
};

class WaveTransform {
 public:
  static constexpr int kFraction = 11;
  static constexpr int kMaxTerms = 63;

  // A component's tables along y and x; they outlive the transform.
  struct Kind {
    const WaveTable* y;
    const WaveTable* x;
  };

  explicit WaveTransform(std::vector<Kind> kinds);

  // `field`: component by component, rows of x. Returns e: W = waves 2^e; waves within 14 bits and sign.
  int to_waves(std::span<const int32_t> field, std::span<int16_t> waves);
  // `waves` within 14 bits and sign. Returns e: f = field 2^e.
  int to_places(std::span<const int16_t> waves, std::span<int32_t> field);

 private:
  [[nodiscard]] size_t n_places() const;
  [[nodiscard]] size_t n_waves() const;

  std::vector<Kind> kinds_;
  std::vector<int16_t> narrow_;  // a product's input
  std::vector<int32_t> wide_;    // a product's sums
};

// out = values 2^-shift, rounded half up, within 14 bits and sign; returns the shift, which is common to all.
int narrow_to_14(std::span<const int32_t> values, std::span<int16_t> out);

}  // namespace ruffini
