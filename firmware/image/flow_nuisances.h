// What a patch of texture does beside moving: directions of its samples that a displacement must not be read from.
//
//   add      v, less what those before it explain (Gram-Schmidt, twice), scaled to 2^14 <= max |v| < 2^15; what then is
//            below a 64th of what it was is not a direction of its own
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
  // At most n_directions times; v is used up.
  void add(std::span<int32_t> v);
  // g: below 2^15.
  void remove(std::span<int32_t> g) const;

 private:
  static constexpr int kBits = 15;
  static constexpr int kLeastBits = 8;  // a 64th, and rounding is a part of it
  // Shifts v so that its largest has kBits bits; how many it had.
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
