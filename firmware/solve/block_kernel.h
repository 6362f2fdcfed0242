// One row of a block-scaled matrix times a vector: the inner loop of every solve.
//
//   sum over the listed blocks b of ((sum over j in b of q[j] u[j]) << shift[b])
//
// Blocks of 32 columns. Bounds as in block_operator.h: |q| <= 16383, so four products fit one int32
// lane. Integer sums do not depend on their order: all versions are equal bit for bit.
#pragma once

#include <cstdint>
#include <span>

namespace ruffini::block_kernel {

inline constexpr int kBlock = 32;

// q: the row's entries, shift: one per block, u: the vector, blocks: which blocks, ascending.
using Row = int64_t (*)(const int16_t* q, const uint8_t* shift, const int16_t* u, std::span<const uint16_t> blocks);

// The reference.
int64_t row_scalar(const int16_t* q, const uint8_t* shift, const int16_t* u, std::span<const uint16_t> blocks);
// Compiled where the target has them (SIMDe in tests).
int64_t row_avx2(const int16_t* q, const uint8_t* shift, const int16_t* u, std::span<const uint16_t> blocks);
int64_t row_neon(const int16_t* q, const uint8_t* shift, const int16_t* u, std::span<const uint16_t> blocks);

// The fastest that this processor runs.
Row best();

}  // namespace ruffini::block_kernel
