// CRC-32C (Castagnoli): reflected polynomial 0x82F63B78, initial and final value 0xFFFFFFFF.
// Check value of "123456789": 0xE3069283.
#pragma once

#include <array>
#include <cstdint>
#include <span>

namespace ruffini {

namespace crc32c_detail {
consteval std::array<uint32_t, 256> make_table() {
  std::array<uint32_t, 256> table{};
  for (uint32_t i = 0; i < 256; ++i) {
    uint32_t crc = i;
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0x82F63B78U : 0U);
    table[i] = crc;
  }
  return table;
}
inline constexpr std::array<uint32_t, 256> kTable = make_table();
}  // namespace crc32c_detail

[[nodiscard]] constexpr uint32_t crc32c(std::span<const uint8_t> bytes) {
  uint32_t crc = 0xFFFFFFFFU;
  for (const uint8_t byte : bytes) crc = (crc >> 8) ^ crc32c_detail::kTable[(crc ^ byte) & 0xFF];
  return ~crc;
}

}  // namespace ruffini
