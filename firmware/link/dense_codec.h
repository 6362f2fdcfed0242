// Node values as bytes: zigzag, blocks of 32, bit packing; sparse with a bitmap of active nodes.
// Byte for byte: proto/README.md. Reentrant, no allocation.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace ruffini {

enum class DenseCodec : uint8_t { kPacked = 0, kSparse = 1 };

// Bytes that `n_values` need at most, in either codec.
[[nodiscard]] constexpr size_t dense_bound(size_t n_values) {
  const size_t n_blocks = (n_values + 31) / 32;
  return n_blocks * (1 + 4 * 32) + (n_values + 7) / 8;
}

struct DenseBytes {
  DenseCodec codec = DenseCodec::kPacked;
  size_t n_bytes = 0;
};

// The smaller of both codecs into `out` (dense_bound(values.size()) bytes). `values` are node by node,
// n_components each.
DenseBytes encode_dense(std::span<const int32_t> values, size_t n_components, std::span<uint8_t> out);

}  // namespace ruffini
