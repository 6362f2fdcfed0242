// Multiplies a few rows of a block-scaled matrix by a vector: the inner loop of every solve.
//
//   out[r] = sum over the listed blocks b of ((sum over j < 32 of q[b][r][j] u[32 b + j]) << shift[b][r])
//
// q[b][r][j] is stored at q[(b n_rows + r) 32 + j] and shift[b][r] at shift[b n_rows + r], so the table is read once,
// in order. Since |q| <= 16383, four products with int16 fit one int32 lane; the loader (block_program.h) proves that
// the int64 sum fits. Integer sums do not depend on their order, so all versions are bit-identical.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <utility>

namespace ruffini::block_kernel {

inline constexpr int kBlock = 32;
inline constexpr int kRows = 8;  // maximum per call: 8 sums stay in registers and u is read once for all of them
inline constexpr int kMaxEntry = 16'383;
inline constexpr size_t kAheadBytes = 4096;  // prefetch distance in the table; fastest of 1024 to 8192 as measured

struct Table {
  const int16_t* q = nullptr;
  const uint8_t* shift = nullptr;
};

// n_rows: 1 to kRows. u: the vector. blocks: indices of the blocks to use, ascending. out: n_rows sums.
using Rows = void (*)(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out);

// The reference.
void rows_scalar(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out);
// Compiled for targets that have these instructions, and by SIMDe in tests.
void rows_avx2(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out);
void rows_neon(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out);

// Returns the fastest version that this processor supports.
Rows fastest_supported();

// Calls Kernel<n>::run with n = n_rows, so that the compiler unrolls over the rows.
template <template <size_t> typename Kernel>
void dispatch(int n_rows, Table table, const int16_t* u, std::span<const uint16_t> blocks, int64_t* out) {
  using Run = void (*)(Table, const int16_t*, std::span<const uint16_t>, int64_t*);
  static constexpr auto kRun = []<size_t... kIndex>(std::index_sequence<kIndex...>) {
    return std::array<Run, kRows>{Kernel<kIndex + 1>::run...};
  }(std::make_index_sequence<kRows>{});
  kRun[static_cast<size_t>(n_rows - 1)](table, u, blocks, out);
}

}  // namespace ruffini::block_kernel
