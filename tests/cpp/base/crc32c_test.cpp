#include "base/crc32c.h"

#include <gtest/gtest.h>

#include <array>
#include <string_view>
#include <vector>

namespace ruffini {
namespace {

uint32_t crc_of(std::string_view text) { return crc32c({reinterpret_cast<const uint8_t*>(text.data()), text.size()}); }

TEST(Crc32c, PublishedValues) {
  EXPECT_EQ(crc_of("123456789"), 0xE3069283U);  // the check value of CRC-32C
  EXPECT_EQ(crc_of(""), 0U);
  // RFC 3720, B.4
  EXPECT_EQ(crc32c(std::vector<uint8_t>(32, 0x00)), 0x8A9136AAU);
  EXPECT_EQ(crc32c(std::vector<uint8_t>(32, 0xFF)), 0x62A8AB43U);
  std::vector<uint8_t> rising(32);
  for (size_t i = 0; i < 32; ++i) rising[i] = static_cast<uint8_t>(i);
  EXPECT_EQ(crc32c(rising), 0x46DD794EU);
}

TEST(Crc32c, SeesEverySingleBitOfALargestFrame) {
  std::vector<uint8_t> data(4'064, 0xA5);
  const uint32_t right = crc32c(data);
  for (size_t bit = 0; bit < data.size() * 8; bit += 101) {
    data[bit / 8] ^= static_cast<uint8_t>(1U << bit % 8);
    EXPECT_NE(crc32c(data), right);
    data[bit / 8] ^= static_cast<uint8_t>(1U << bit % 8);
  }
}

}  // namespace
}  // namespace ruffini
