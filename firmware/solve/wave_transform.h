// Transforms fields on a rectangular grid to waves along x and y, and back, in 16-bit block floating point.
//
//   to_waves:  W = Y f X^T     to_places: f = Y^T W X     Y, X: tables of cosines or sines, waves x places
//
// Each transform is two matrix products of 16-bit numbers with 32-bit sums. Before every product, all components are
// rounded to 14 bits and sign with one common shift; table entries are at most 2^kFraction and a sum has at most
// kMaxTerms of them: 2^14 2^11 63 < 2^31, so no sum overflows. Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace ruffini {

// Table of one axis: waves x places, and its transpose.
struct WaveTable {
  // Precondition: entries.size() == n_waves * n_places, all within +-2^WaveTransform::kFraction.
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

  // Tables of a component along y and x. They must outlive the transform.
  struct Kind {
    const WaveTable* y;
    const WaveTable* x;
  };

  explicit WaveTransform(std::vector<Kind> kinds);

  // `field`: component by component, row by row. Returns e with W = waves 2^e; waves have 14 bits and sign.
  int to_waves(std::span<const int32_t> field, std::span<int16_t> waves);
  // Precondition: `waves` has 14 bits and sign. Returns e with f = field 2^e.
  int to_places(std::span<const int16_t> waves, std::span<int32_t> field);

 private:
  [[nodiscard]] size_t n_places() const;
  [[nodiscard]] size_t n_waves() const;

  std::vector<Kind> kinds_;
  std::vector<int16_t> narrow_;  // a product's input
  std::vector<int32_t> wide_;    // a product's sums
};

// out = values 2^-shift, rounded half up to 14 bits and sign. Returns the common shift.
int narrow_to_14(std::span<const int32_t> values, std::span<int16_t> out);

}  // namespace ruffini
