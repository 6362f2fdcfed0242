#include "hw/identity.h"

#include <gtest/gtest.h>

#include <random>

#include "base/crc32c.h"
#include "support/fake_bus.h"

namespace ruffini {
namespace {

// A gel: serial G-0007, name soft, made 2026-11. The same bytes are in tests/py/device/test_eeprom.py.
const std::vector<uint8_t> kGel = {'R', 'F', 'I', 'D', 1,   2,   23,  0,    1,    6,    'G', '-',
                                   '0', '0', '0', '7', 2,   4,   's', 'o',  'f',  't',  4,   7,
                                   '2', '0', '2', '6', '-', '1', '1', 0xF4, 0xE9, 0x60, 0x5F};

std::vector<uint8_t> with_crc(std::vector<uint8_t> bytes) {
  const uint32_t crc = crc32c(bytes);
  for (int i = 0; i < 4; ++i) bytes.push_back(static_cast<uint8_t>(crc >> (8 * i)));
  return bytes;
}

std::vector<uint8_t> entries(std::vector<uint8_t> of, uint8_t version = 1) {
  std::vector<uint8_t> bytes = {'R', 'F', 'I', 'D', version, 1, static_cast<uint8_t>(of.size()), 0};
  bytes.insert(bytes.end(), of.begin(), of.end());
  return with_crc(bytes);
}

TEST(Identity, IsWhatTheHostWrites) {
  const auto gel = parse_identity(kGel, IdentityKind::kGel);
  ASSERT_TRUE(gel) << gel.error().message;
  EXPECT_EQ(gel.value().serial, "G-0007");
  EXPECT_EQ(gel.value().name, "soft");
  EXPECT_EQ(gel.value().revision, "");
  EXPECT_EQ(gel.value().made, "2026-11");
}

TEST(Identity, EveryFlippedBitAndEveryLengthIsRefused) {
  for (size_t bit = 0; bit < kGel.size() * 8; ++bit) {
    std::vector<uint8_t> flipped = kGel;
    flipped[bit / 8] ^= static_cast<uint8_t>(1U << (bit % 8));
    EXPECT_FALSE(parse_identity(flipped, IdentityKind::kGel)) << bit;
  }
  for (size_t n = 0; n < kGel.size(); ++n) {
    EXPECT_FALSE(parse_identity(std::span(kGel).first(n), IdentityKind::kGel)) << n;
  }
}

TEST(Identity, OddOnesAreRefused) {
  EXPECT_FALSE(parse_identity(kGel, IdentityKind::kBoard));
  EXPECT_TRUE(parse_identity(entries({1, 1, 'a'}), IdentityKind::kBoard));
  EXPECT_TRUE(parse_identity(entries({9, 2, 0, 255, 1, 1, 'a'}), IdentityKind::kBoard));  // a tag of the future
  EXPECT_FALSE(parse_identity(entries({1, 1, 'a'}, 2), IdentityKind::kBoard));
  EXPECT_FALSE(parse_identity(entries({}), IdentityKind::kBoard));
  EXPECT_FALSE(parse_identity(entries({1, 0}), IdentityKind::kBoard));
  EXPECT_FALSE(parse_identity(entries({1, 3, 'a', '/', 'b'}), IdentityKind::kBoard));  // it becomes a folder's name
  EXPECT_FALSE(parse_identity(entries({1, 2, '.', '.'}), IdentityKind::kBoard));
  EXPECT_FALSE(parse_identity(entries({1, 1, 'a', 2, 1, '\n'}), IdentityKind::kBoard));
  EXPECT_FALSE(parse_identity(entries({1, 1, 'a', 2}), IdentityKind::kBoard));
  EXPECT_FALSE(parse_identity(entries({1, 9, 'a'}), IdentityKind::kBoard));
}

TEST(Identity, RandomEntriesNeverReadBeyondTheirEnd) {
  std::mt19937 random(3);
  for (int i = 0; i < 20'000; ++i) {
    std::vector<uint8_t> bytes(random() % 24);
    for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(random() % 8);
    const auto found = parse_identity(entries(bytes), IdentityKind::kBoard);
    if (found) {
      EXPECT_FALSE(found.value().serial.empty());
    }
  }
}

TEST(Identity, IsReadOverTheBus) {
  for (const int address_bytes : {1, 2}) {
    FakeBus bus(address_bytes);
    bus.memories[0x51] = kGel;
    bus.memories[0x51].resize(256, 0xFF);
    const auto gel = read_identity(bus, 0x51, address_bytes, IdentityKind::kGel);
    ASSERT_TRUE(gel) << gel.error().message;
    EXPECT_EQ(gel.value().serial, "G-0007");
  }
}

TEST(Identity, AFaultOrTwoOfTheBusAreOverThirdIsNot) {
  FakeBus bus(1);
  bus.memories[0x51] = kGel;
  bus.errors = {EIO, ETIMEDOUT};
  EXPECT_TRUE(read_identity(bus, 0x51, 1, IdentityKind::kGel));
  bus.errors = {EIO, EIO, EIO};
  bus.n_transfers = 0;
  const auto broken = read_identity(bus, 0x51, 1, IdentityKind::kGel);
  ASSERT_FALSE(broken);
  EXPECT_EQ(bus.n_transfers, 3);
  EXPECT_EQ(broken.error().kind, ErrorKind::kUnavailable);
  EXPECT_NE(broken.error().message.find("fake bus, address 0x51: Input/output error"), std::string::npos)
      << broken.error().message;
}

TEST(Identity, WhatIsMissingIsSaid) {
  FakeBus bus(1);
  const auto absent = read_identity(bus, 0x51, 1, IdentityKind::kGel);
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().kind, ErrorKind::kUnavailable);
  EXPECT_NE(absent.error().message.find("nobody answers"), std::string::npos);
  bus.memories[0x51].assign(256, 0xFF);  // as it comes from the factory
  const auto empty = read_identity(bus, 0x51, 1, IdentityKind::kGel);
  ASSERT_FALSE(empty);
  EXPECT_EQ(empty.error().kind, ErrorKind::kBadInput);
  EXPECT_NE(empty.error().message.find("board eeprom write"), std::string::npos);
}

TEST(I2c, ABusThatIsMissingIsSaidWithItsRemedy) {
  const auto bus = open_i2c("/dev/i2c-none");
  ASSERT_FALSE(bus);
  EXPECT_NE(bus.error().message.find("dtparam=i2c_arm=on"), std::string::npos);
  const auto other = open_i2c("/dev/null");
  ASSERT_FALSE(other);
  EXPECT_NE(other.error().message.find("no I2C bus"), std::string::npos);
}

}  // namespace
}  // namespace ruffini
