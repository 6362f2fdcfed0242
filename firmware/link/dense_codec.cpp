#include "link/dense_codec.h"

#include <algorithm>
#include <bit>

namespace ruffini {
namespace {

constexpr size_t kBlock = 32;

uint32_t zigzag(int32_t v) { return (static_cast<uint32_t>(v) << 1) ^ static_cast<uint32_t>(v >> 31); }

// Collects values into blocks of 32 and writes each as its width in bits and 4 x width bytes.
class BlockWriter {
 public:
  explicit BlockWriter(uint8_t* out) : out_(out) {}

  void add(int32_t value) {
    block_[n_++] = zigzag(value);
    if (n_ == kBlock) flush();
  }

  size_t finish() {
    if (n_ > 0) flush();
    return at_;
  }

 private:
  void flush() {
    std::fill(block_ + n_, block_ + kBlock, 0U);
    uint32_t any = 0;
    for (const uint32_t v : block_) any |= v;
    const auto width = static_cast<uint32_t>(std::bit_width(any));
    out_[at_++] = static_cast<uint8_t>(width);
    uint64_t bits = 0;
    uint32_t n_bits = 0;
    for (const uint32_t v : block_) {
      bits |= uint64_t{v} << n_bits;
      n_bits += width;
      while (n_bits >= 8) {
        out_[at_++] = static_cast<uint8_t>(bits);
        bits >>= 8;
        n_bits -= 8;
      }
    }
    n_ = 0;
  }

  uint8_t* out_;
  size_t at_ = 0;
  uint32_t block_[kBlock];
  size_t n_ = 0;
};

}  // namespace

DenseBytes encode_dense(std::span<const int32_t> values, size_t n_components, std::span<uint8_t> out) {
  const size_t n_nodes = values.size() / n_components;
  const auto is_active = [&](size_t node) {
    return std::any_of(&values[node * n_components], &values[node * n_components] + n_components,
                       [](int32_t v) { return v != 0; });
  };
  size_t n_active = 0;
  for (size_t node = 0; node < n_nodes; ++node) n_active += is_active(node) ? size_t{1} : size_t{0};
  // The bitmap pays off if at least an eighth of the nodes are zero: it costs one bit per node, a value several bits.
  if (n_active * 8 >= n_nodes * 7) {
    BlockWriter writer(out.data());
    for (const int32_t v : values) writer.add(v);
    return {DenseCodec::kPacked, writer.finish()};
  }
  const size_t n_bitmap = (n_nodes + 7) / 8;
  std::fill(out.begin(), out.begin() + static_cast<ptrdiff_t>(n_bitmap), uint8_t{0});
  BlockWriter writer(out.data() + n_bitmap);
  for (size_t node = 0; node < n_nodes; ++node) {
    if (!is_active(node)) continue;
    out[node / 8] = static_cast<uint8_t>(out[node / 8] | 1U << (node % 8));
    for (size_t c = 0; c < n_components; ++c) writer.add(values[node * n_components + c]);
  }
  return {DenseCodec::kSparse, n_bitmap + writer.finish()};
}

}  // namespace ruffini
