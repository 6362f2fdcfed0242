// Node values back from their bytes, from proto/README.md alone: one bit after the other.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace ruffini::test {

// Values of `n_values` in blocks of 32; nullopt where the bytes are not exactly these.
inline std::optional<std::vector<int32_t>> unpack(std::span<const uint8_t> bytes, size_t n_values) {
  std::vector<int32_t> out;
  size_t at = 0;
  while (out.size() < n_values) {
    if (at == bytes.size()) return std::nullopt;
    const size_t width = bytes[at++];
    if (width > 32 || bytes.size() - at < 4 * width) return std::nullopt;
    for (size_t i = 0; i < 32; ++i) {
      uint32_t zigzag = 0;
      for (size_t k = 0; k < width; ++k) {
        const size_t bit = i * width + k;
        zigzag |= (uint32_t{bytes[at + bit / 8]} >> bit % 8 & 1U) << k;
      }
      const bool is_negative = (zigzag & 1U) != 0;
      const int64_t half = zigzag / 2;
      if (out.size() < n_values) out.push_back(static_cast<int32_t>(is_negative ? -half - 1 : half));
    }
    at += 4 * width;
  }
  return at == bytes.size() ? std::optional(out) : std::nullopt;
}

inline std::optional<std::vector<int32_t>> decode_dense(bool is_sparse, size_t n_nodes, size_t n_components,
                                                        std::span<const uint8_t> bytes) {
  if (!is_sparse) return unpack(bytes, n_nodes * n_components);
  const size_t n_bitmap = (n_nodes + 7) / 8;
  if (bytes.size() < n_bitmap) return std::nullopt;
  std::vector<size_t> active;
  for (size_t i = 0; i < 8 * n_bitmap; ++i) {
    if ((bytes[i / 8] >> i % 8 & 1) == 0) continue;
    if (i >= n_nodes) return std::nullopt;
    active.push_back(i);
  }
  const auto packed = unpack(bytes.subspan(n_bitmap), active.size() * n_components);
  if (!packed) return std::nullopt;
  std::vector<int32_t> out(n_nodes * n_components);
  for (size_t i = 0; i < active.size(); ++i) {
    for (size_t c = 0; c < n_components; ++c) out[active[i] * n_components + c] = (*packed)[i * n_components + c];
  }
  return out;
}

}  // namespace ruffini::test
