// Frames according to proto/README.md: CRC-32C and COBS.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

namespace ruffini::client {

inline constexpr uint8_t kProtocolVersion = 1;
inline constexpr size_t kHeaderBytes = 12;
inline constexpr size_t kCrcBytes = 4;
inline constexpr size_t kMaxPayloadBytes = 4048;
inline constexpr uint8_t kFromHost = 1, kSimulated = 2, kReplay = 4, kKnownFlags8 = 7;

[[nodiscard]] uint32_t crc32c(const uint8_t* bytes, size_t n);

// Returns the number of decoded bytes, at most n; nullopt if the input is not valid COBS. Precondition: no byte of `in`
// is zero.
[[nodiscard]] std::optional<size_t> cobs_decode(const uint8_t* in, size_t n, uint8_t* out);
[[nodiscard]] std::vector<uint8_t> cobs_encode(const std::vector<uint8_t>& in);

[[nodiscard]] inline uint32_t get_u32(const uint8_t* in) {
  return uint32_t{in[0]} | uint32_t{in[1]} << 8 | uint32_t{in[2]} << 16 | uint32_t{in[3]} << 24;
}

inline void put_u32(std::vector<uint8_t>& out, uint32_t v) {
  for (int shift = 0; shift < 32; shift += 8) out.push_back(static_cast<uint8_t>(v >> shift));
}

}  // namespace ruffini::client
