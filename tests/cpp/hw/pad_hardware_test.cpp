#include "hw/pad_hardware.h"

#include <gtest/gtest.h>

#include "base/crc32c.h"
#include "support/fake_bus.h"

namespace ruffini {
namespace {

constexpr uint8_t kBoardAt = 0x50;
constexpr uint8_t kGelAt = 0x51;

std::vector<uint8_t> memory(IdentityKind kind, const std::string& serial, const std::string& name) {
  std::vector<uint8_t> bytes = {'R', 'F', 'I', 'D', 1, static_cast<uint8_t>(kind), 0, 0};
  const std::string* const texts[] = {&serial, &name};
  for (uint8_t tag = 1; tag <= 2; ++tag) {
    const std::string& text = *texts[tag - 1];
    bytes.push_back(tag);
    bytes.push_back(static_cast<uint8_t>(text.size()));
    bytes.insert(bytes.end(), text.begin(), text.end());
  }
  bytes[6] = static_cast<uint8_t>(bytes.size() - 8);
  const uint32_t crc = crc32c(bytes);
  for (int i = 0; i < 4; ++i) bytes.push_back(static_cast<uint8_t>(crc >> (8 * i)));
  return bytes;
}

class PadHardwareTest : public testing::Test {
 protected:
  PadHardwareTest() {
    board_.name = "softpad";
    board_.eeprom = {"/dev/i2c-1", kBoardAt, kGelAt, 2};
    auto bus = std::make_unique<FakeBus>(2);
    bus->memories[kBoardAt] = memory(IdentityKind::kBoard, "B-1", "softpad");
    bus->memories[kGelAt] = memory(IdentityKind::kGel, "G-1", "blue");
    bus_ = bus.get();
    owned_ = std::move(bus);
  }
  Result<PadHardware> open() { return PadHardware::open(board_, std::move(owned_)); }

  BoardSettings board_;
  FakeBus* bus_;
  std::unique_ptr<I2cBus> owned_;
};

TEST_F(PadHardwareTest, EachGelHasItsOwnFolder) {
  auto pad = open();
  ASSERT_TRUE(pad) << pad.error().message;
  EXPECT_EQ(pad.value().board_serial(), "B-1");
  EXPECT_EQ(pad.value().store_folder("/var/lib/ruffini"), "/var/lib/ruffini/gel-G-1");
  EXPECT_EQ(pad.value().gel_fault(), "");
}

TEST_F(PadHardwareTest, WithoutEepromsNothingIsAsked) {
  board_.eeprom = {};
  auto pad = PadHardware::open(board_);
  ASSERT_TRUE(pad);
  EXPECT_EQ(pad.value().store_folder("/s"), "/s");
  EXPECT_EQ(pad.value().board_serial(), "");
  EXPECT_EQ(pad.value().gel_fault(), "");
}

TEST_F(PadHardwareTest, LampsThatCannotBeHadAreSaidAndLeftOut) {
  board_.eeprom = {};
  board_.light = {"gpiochip-none", "LAMPS"};
  const auto none = PadHardware::open(board_);
  ASSERT_TRUE(none);
  EXPECT_NE(none.value().lamp_error().find("/dev/gpiochip-none"), std::string::npos) << none.value().lamp_error();
  EXPECT_NE(none.value().lamp_error().find("gpiodetect"), std::string::npos);
  board_.light.chip = "/dev/null";
  const auto other = PadHardware::open(board_);
  ASSERT_TRUE(other);
  EXPECT_NE(other.value().lamp_error().find("is no GPIO chip"), std::string::npos) << other.value().lamp_error();
}

TEST_F(PadHardwareTest, ADriverThatCannotBeHadIsSaidBesideTheLineAndStaysAFault) {
  board_.eeprom = {};
  board_.light = {"gpiochip-none", "LAMPS"};
  board_.led_driver = {"/dev/i2c-none", 0x15, 1'000, {1'000}, 0, INT32_MAX};
  auto pad = PadHardware::open(board_);
  ASSERT_TRUE(pad);
  EXPECT_NE(pad.value().lamp_error().find("/dev/gpiochip-none"), std::string::npos) << pad.value().lamp_error();
  EXPECT_NE(pad.value().lamp_error().find("; /dev/i2c-none: cannot be opened"), std::string::npos)
      << pad.value().lamp_error();
  EXPECT_EQ(pad.value().lamp_fault({}), pad.value().lamp_error());
  EXPECT_EQ(pad.value().lamps(), nullptr);
  const std::string off = PadHardware::lights_off(board_);
  EXPECT_NE(off.find("/dev/i2c-none"), std::string::npos) << off;
  EXPECT_NE(off.find("/dev/gpiochip-none"), std::string::npos) << off;
}

TEST_F(PadHardwareTest, WithoutLampsOfItsOwnNothingIsSaidOfThem) {
  auto pad = open();
  ASSERT_TRUE(pad);
  EXPECT_EQ(pad.value().lamp_fault({}), "");
  board_.eeprom = {};
  EXPECT_EQ(PadHardware::lights_off(board_), "");
}

TEST_F(PadHardwareTest, AnotherGelIsToldAtOnce) {
  auto pad = open();
  ASSERT_TRUE(pad);
  bus_->memories[kGelAt] = memory(IdentityKind::kGel, "G-2", "blue");
  EXPECT_NE(pad.value().gel_fault().find("G-1 was taken for G-2"), std::string::npos);
}

TEST_F(PadHardwareTest, ASecondOfSilenceIsBorneTwoAreNot) {
  auto pad = open();
  ASSERT_TRUE(pad);
  const std::vector<uint8_t> gel = bus_->memories[kGelAt];
  bus_->memories.erase(kGelAt);
  EXPECT_EQ(pad.value().gel_fault(), "");
  bus_->memories[kGelAt] = gel;
  EXPECT_EQ(pad.value().gel_fault(), "");
  bus_->memories.erase(kGelAt);
  EXPECT_EQ(pad.value().gel_fault(), "");
  EXPECT_NE(pad.value().gel_fault().find("gel G-1 is gone"), std::string::npos);
}

TEST_F(PadHardwareTest, AnotherBoardIsRefused) {
  bus_->memories[kBoardAt] = memory(IdentityKind::kBoard, "B-1", "hardpad");
  const auto pad = open();
  ASSERT_FALSE(pad);
  EXPECT_EQ(pad.error().kind, ErrorKind::kRefused);
  EXPECT_NE(pad.error().message.find("--board hardpad"), std::string::npos);
}

TEST_F(PadHardwareTest, WithoutItsGelItDoesNotStart) {
  bus_->memories.erase(kGelAt);
  const auto pad = open();
  ASSERT_FALSE(pad);
  EXPECT_EQ(pad.error().kind, ErrorKind::kUnavailable);
  EXPECT_NE(pad.error().message.find("the gel's EEPROM"), std::string::npos);
}

}  // namespace
}  // namespace ruffini
