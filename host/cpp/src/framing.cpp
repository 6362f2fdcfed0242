#include "framing.h"

#include <array>
#include <cstring>

namespace ruffini::client {
namespace {

constexpr uint32_t kPolynomial = 0x82F6'3B78;  // Castagnoli's, reflected
constexpr size_t kLongestRun = 254;

using Tables = std::array<std::array<uint32_t, 256>, 4>;

// kTables[k][b]: the CRC of byte b and k zeros after it, so that four bytes go in one step.
constexpr Tables make_tables() {
  Tables t{};
  for (uint32_t i = 0; i < 256; ++i) {
    uint32_t c = i;
    for (int bit = 0; bit < 8; ++bit) c = (c & 1) != 0 ? c >> 1 ^ kPolynomial : c >> 1;
    t[0][i] = c;
  }
  for (uint32_t i = 0; i < 256; ++i) {
    for (size_t k = 1; k < 4; ++k) t[k][i] = t[k - 1][i] >> 8 ^ t[0][t[k - 1][i] & 255];
  }
  return t;
}

constexpr Tables kTables = make_tables();

}  // namespace

uint32_t crc32c(const uint8_t* bytes, size_t n) {
  uint32_t crc = UINT32_MAX;
  for (; n >= 4; n -= 4, bytes += 4) {
    crc ^= get_u32(bytes);
    crc = kTables[3][crc & 255] ^ kTables[2][crc >> 8 & 255] ^ kTables[1][crc >> 16 & 255] ^ kTables[0][crc >> 24];
  }
  for (; n > 0; --n, ++bytes) crc = kTables[0][(crc ^ *bytes) & 255] ^ crc >> 8;
  return ~crc;
}

std::optional<size_t> cobs_decode(const uint8_t* in, size_t n, uint8_t* out) {
  size_t at = 0;
  size_t n_out = 0;
  while (at < n) {
    const size_t run = in[at] - size_t{1};
    ++at;
    if (run > n - at) return std::nullopt;
    if (run > 0) std::memcpy(out + n_out, in + at, run);
    at += run;
    n_out += run;
    if (run != kLongestRun && at < n) out[n_out++] = 0;
  }
  return n_out;
}

std::vector<uint8_t> cobs_encode(const std::vector<uint8_t>& in) {
  std::vector<uint8_t> out = {1};
  size_t code_at = 0;
  for (const uint8_t byte : in) {
    if (byte != 0) {
      out.push_back(byte);
      ++out[code_at];
    }
    if (byte == 0 || out[code_at] == 0xFF) {
      code_at = out.size();
      out.push_back(1);
    }
  }
  return out;
}

}  // namespace ruffini::client
