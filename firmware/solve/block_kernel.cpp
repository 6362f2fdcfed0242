#include "solve/block_kernel.h"

#include "base/processor.h"

namespace ruffini::block_kernel {

void rows_scalar(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out) {
  constexpr size_t n = kBlock / 4;
  for (int r = 0; r < n_rows; ++r) {
    int64_t sum = 0;
    for (const uint16_t b : blocks) {
      const size_t at = size_t{b} * static_cast<size_t>(n_rows) + static_cast<size_t>(r);
      const int16_t* entry = table.q + at * kBlock;
      const int16_t* v = u + size_t{b} * kBlock;
      // Eight lanes of four products: |lane| <= 4 x 16383 x 32768 < 2^31.
      int64_t block = 0;
      for (size_t i = 0; i < n; ++i) {
        block += entry[i] * v[i] + entry[i + n] * v[i + n] + entry[i + 2 * n] * v[i + 2 * n] +
                 entry[i + 3 * n] * v[i + 3 * n];
      }
      sum += block * (int64_t{1} << table.shift[at]);
    }
    out[r] = sum;
  }
}

Rows fastest_supported() {
#if defined(__x86_64__)
  return has_avx2() ? rows_avx2 : rows_scalar;
#elif defined(__aarch64__)
  return rows_neon;
#else
  return rows_scalar;
#endif
}

}  // namespace ruffini::block_kernel
