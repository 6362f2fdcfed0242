#include "solve/block_kernel.h"

#include <array>

namespace ruffini::block_kernel {

int64_t row_scalar(const int16_t* q, const uint8_t* shift, const int16_t* u, std::span<const uint16_t> blocks) {
  constexpr size_t n = kBlock / 4;
  int64_t sum = 0;
  for (const uint16_t b : blocks) {
    const int16_t* entry = q + size_t{b} * kBlock;
    const int16_t* v = u + size_t{b} * kBlock;
    // Eight lanes of four products: |lane| <= 4 x 16383 x 32768 < 2^31.
    std::array<int32_t, n> lanes;
    for (size_t i = 0; i < n; ++i) {
      lanes[i] =
          entry[i] * v[i] + entry[i + n] * v[i + n] + entry[i + 2 * n] * v[i + 2 * n] + entry[i + 3 * n] * v[i + 3 * n];
    }
    int64_t block = 0;
    for (const int32_t lane : lanes) block += lane;
    sum += block << shift[b];
  }
  return sum;
}

Row best() {
#if defined(__x86_64__)
  return __builtin_cpu_supports("avx2") ? row_avx2 : row_scalar;
#elif defined(__aarch64__)
  return row_neon;
#else
  return row_scalar;
#endif
}

}  // namespace ruffini::block_kernel
