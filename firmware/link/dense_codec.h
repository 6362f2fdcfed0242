// Node values as bytes: zigzag, blocks of 32, bit packing; sparse with a bitmap of active nodes.
// Byte for byte: proto/README.md. Reentrant, no allocation.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace ruffini {

enum class DenseCodec : uint8_t { kPacked = 0, kSparse = 1 };

// Upper bound of the bytes for `n_values`, with either codec.
[[nodiscard]] constexpr size_t dense_bound(size_t n_values) {
  const size_t n_blocks = (n_values + 31) / 32;
  return n_blocks * (1 + 4 * 32) + (n_values + 7) / 8;
}

struct DenseBytes {
  DenseCodec codec = DenseCodec::kPacked;
  size_t n_bytes = 0;
};

// Writes the smaller encoding to `out` (dense_bound(values.size()) bytes). `values`: n_components per node, node by
// node.
DenseBytes encode_dense(std::span<const int32_t> values, size_t n_components, std::span<uint8_t> out);

}  // namespace ruffini
