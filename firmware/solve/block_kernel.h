// A few rows of a block-scaled matrix times a vector: the inner loop of every solve.
//
//   out[r] = sum over the listed blocks b of ((sum over j < 32 of q[b][r][j] u[32 b + j]) << shift[b][r])
//
// q[b][r][j] lies at q[(b n_rows + r) 32 + j] and shift[b][r] at shift[b n_rows + r], so that the table is
// read once and in order. Bounds: |q| <= 16383, so four products with int16 fit one int32 lane; the
// loader (block_program.h) proves that the int64 sum fits. Integer sums do not depend on their order:
// all versions are equal bit for bit.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <utility>

namespace ruffini::block_kernel {

inline constexpr int kBlock = 32;
inline constexpr int kRows = 8;  // at most, of one call: 8 sums stay in registers, u is read once for them
inline constexpr int kMaxEntry = 16'383;
inline constexpr size_t kAheadBytes = 4096;  // of the table, fetched early: best of 1024 to 8192, measured

struct Table {
  const int16_t* q = nullptr;
  const uint8_t* shift = nullptr;
};

// n_rows: 1..kRows, u: the vector, blocks: which blocks, ascending, out: n_rows sums.
using Rows = void (*)(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out);

// The reference.
void rows_scalar(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out);
// Compiled where the target has them (SIMDe in tests).
void rows_avx2(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out);
void rows_neon(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out);

// The fastest that this processor runs.
Rows best();

// Kernel<n>::run for the number of rows of this call: the compiler unrolls over the rows.
template <template <size_t> typename Kernel>
void dispatch(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out) {
  using Run = void (*)(Table, const int16_t*, std::span<const uint16_t>, int64_t*);
  static constexpr auto kRun = []<size_t... kIndex>(std::index_sequence<kIndex...>) {
    return std::array<Run, kRows>{Kernel<kIndex + 1>::run...};
  }(std::make_index_sequence<kRows>{});
  kRun[static_cast<size_t>(n_rows - 1)](table, u, blocks, out);
}

}  // namespace ruffini::block_kernel
