// Directions in which the samples of a texture patch change without displacement; displacement must not be estimated
// from them.
//
//   add      v minus its projection on earlier directions (Gram-Schmidt, twice), scaled to 2^14 <= max |v| < 2^15;
//            dropped if less than a 64th of it remains
//   remove   g - sum of q (q . g) / (q . q)
//
// Any thread; no allocation after the constructor.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace ruffini {

class FlowNuisances {
 public:
  FlowNuisances(size_t n_samples, size_t n_directions);

  void clear() { n_ = 0; }
  // Call at most n_directions times. Overwrites v.
  void add(std::span<int32_t> v);
  // Precondition: |g| < 2^15.
  void remove(std::span<int32_t> g) const;

 private:
  static constexpr int kBits = 15;
  static constexpr int kMinBits = 8;  // a 64th, including rounding
  // Shifts v so that its largest element has kBits bits. Returns the number of bits before.
  static int scale(std::span<int32_t> v);
  [[nodiscard]] std::span<const int32_t> direction(size_t i) const {
    return {all_.data() + i * n_samples_, n_samples_};
  }

  size_t n_samples_;
  size_t n_ = 0;
  std::vector<int32_t> all_;
  std::vector<int64_t> square_;
};

}  // namespace ruffini
