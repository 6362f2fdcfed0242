#include "hw/led_driver.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cerrno>
#include <deque>
#include <vector>

#include "hw/doctor.h"

namespace ruffini {
namespace {

constexpr uint8_t kAt = 0x15;
using Bytes = std::vector<uint8_t>;

// A PCA9955B as its data sheet has it after power-up, with all that was written to it.
struct Chip {
  std::vector<Bytes> writes;
  std::array<uint8_t, 0x50> registers{};
  std::deque<int> errors;  // of the next transfers; 0: none
  bool keeps = true;
};

class ChipBus final : public I2cBus {
 public:
  explicit ChipBus(Chip& chip) : chip_(chip) {}
  int transfer(uint8_t address, std::span<const uint8_t> out, std::span<uint8_t> in) override {
    if (!chip_.errors.empty()) {
      const int error = chip_.errors.front();
      chip_.errors.pop_front();
      if (error != 0) return error;
    }
    if (address != kAt || out.empty()) return ENXIO;
    const bool counts_on = (out[0] & 0x80) != 0;
    size_t at = out[0] & 0x7F;
    if (in.empty()) chip_.writes.emplace_back(out.begin(), out.end());
    for (const uint8_t value : out.subspan(1)) {
      if (chip_.keeps) chip_.registers.at(at) = value;
      at += counts_on ? 1 : 0;
    }
    for (uint8_t& value : in) {
      value = chip_.registers.at(at);
      at += counts_on ? 1 : 0;
    }
    return 0;
  }
  [[nodiscard]] std::string name() const override { return "/dev/i2c-9"; }

 private:
  Chip& chip_;
};

class LedDriverTest : public testing::Test {
 protected:
  LedDriverTest() { chip_.registers[0] = 0x89, chip_.registers[1] = 0x05; }
  Result<std::unique_ptr<LedDriver>> open() {
    return LedDriver::open(std::make_unique<ChipBus>(chip_), settings_,
                           [this](std::chrono::milliseconds time) { slept_.push_back(time.count()); });
  }

  Chip chip_;
  std::vector<int64_t> slept_;
  // 1 kOhm: 225 uA a step. 10 mA are 44.4 steps, 20 mA 88.9, 57.375 mA 255.
  LedDriverSettings settings_{"/dev/i2c-9", kAt, 1'000, {10'000, 0, 20'000, 225, 0, 57'375}, 0, INT32_MAX};
};

TEST_F(LedDriverTest, EveryByteOfAStartIsAsInTheDataSheet) {
  auto driver = open();
  ASSERT_TRUE(driver) << driver.error().message;
  const std::vector<Bytes> expected = {
      {0x82, 0, 0, 0, 0},                                          // LEDOUT0 to 3: off
      {0x80, 0},                                                   // MODE1: awake, no other address
      {0x81, 0x10},                                                // MODE2: faults looked for again
      {0x98, 44, 0, 89, 1, 0, 255, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0},  // IREF0 to 15
      {0x82, 0x51, 0x04, 0, 0},                                    // outputs 0, 2, 3 of the first byte, 5 of the second
  };
  EXPECT_EQ(chip_.writes, expected);
  EXPECT_TRUE(slept_.empty());
  EXPECT_EQ(driver.value()->check({}), "");
}

TEST_F(LedDriverTest, TheRampRisesToTheCurrentsInItsTime) {
  settings_.ramp_ms = 640;
  settings_.currents_ua = {57'375, 7'200};
  const auto driver = open();
  ASSERT_TRUE(driver);
  EXPECT_EQ(slept_, std::vector<int64_t>(31, 20));
  int before = 0;
  int n = 0;
  for (const Bytes& one : chip_.writes) {
    if (one[0] != 0x98) continue;
    EXPECT_GT(int{one[1]}, before);
    before = one[1];
    ++n;
  }
  EXPECT_EQ(n, 32);
  EXPECT_EQ(chip_.registers[0x18], 255);
  EXPECT_EQ(chip_.registers[0x19], 32);
  // Lit only once the first, smallest current is set.
  EXPECT_EQ(chip_.writes[3][1], 7);
  EXPECT_EQ(chip_.writes[4], (Bytes{0x82, 0x05, 0, 0, 0}));
}

TEST_F(LedDriverTest, TheLampsGoOutAtTheEnd) {
  {
    const auto driver = open();
  }
  EXPECT_EQ(chip_.writes.back(), (Bytes{0x82, 0, 0, 0, 0}));
  EXPECT_EQ(chip_.registers[0x02], 0);
  EXPECT_EQ(chip_.registers[0x03], 0);
}

TEST_F(LedDriverTest, ACurrentThatTheResistorDoesNotAllowIsRefusedInTheDark) {
  settings_.resistor_ohm = 2'000;
  const auto driver = open();
  ASSERT_FALSE(driver);
  EXPECT_EQ(driver.error().kind, ErrorKind::kBadInput);
  EXPECT_NE(driver.error().message.find("57375 uA is more than 2000 Ohm allow (28687 uA)"), std::string::npos)
      << driver.error().message;
  for (const Bytes& one : chip_.writes) EXPECT_EQ(one, (Bytes{0x82, 0, 0, 0, 0}));
}

TEST_F(LedDriverTest, NobodyThere) {
  settings_.address = 0x16;
  const auto driver = open();
  ASSERT_FALSE(driver);
  EXPECT_EQ(driver.error().kind, ErrorKind::kUnavailable);
  EXPECT_NE(driver.error().message.find("/dev/i2c-9, address 0x16: nobody answers"), std::string::npos);
}

TEST_F(LedDriverTest, ADisturbedTransferIsTriedAgain) {
  chip_.errors = {EIO, EIO, 0, 0, ETIMEDOUT};
  EXPECT_TRUE(open());
}

TEST_F(LedDriverTest, AnotherChipIsToldApart) {
  chip_.keeps = false;
  const auto driver = open();
  ASSERT_FALSE(driver);
  EXPECT_NE(driver.error().message.find("is it a PCA9955B?"), std::string::npos);
}

TEST_F(LedDriverTest, TheDoctorFindsItAndSwitchesNothing) {
  ChipBus bus(chip_);
  const Check there = examine_lamps(settings_, &bus);
  EXPECT_EQ(there.state, CheckState::kOk);
  EXPECT_EQ(there.found, "their driver answers on /dev/i2c-9");
  EXPECT_TRUE(chip_.writes.empty());
  settings_.address = 0x16;
  const Check silent = examine_lamps(settings_, &bus);
  EXPECT_EQ(silent.state, CheckState::kFailed);
  EXPECT_NE(silent.found.find("address 0x16: nobody answers"), std::string::npos) << silent.found;
  settings_.bus = "/dev/i2c-none";
  EXPECT_NE(examine_lamps(settings_).found.find("/dev/i2c-none: cannot be opened"), std::string::npos);
  EXPECT_EQ(examine_lamps({}).state, CheckState::kOk);
}

TEST_F(LedDriverTest, SilenceIsSaidAndOver) {
  auto driver = open();
  ASSERT_TRUE(driver);
  chip_.errors = {ENXIO, ENXIO, ENXIO};
  EXPECT_NE(driver.value()->check({}).find("nobody answers"), std::string::npos);
  EXPECT_EQ(driver.value()->check({}), "");
}

TEST_F(LedDriverTest, AChipThatLostItsSupplyIsTold) {
  auto driver = open();
  ASSERT_TRUE(driver);
  const auto lit = chip_.registers;
  chip_.registers[0x18] = 0;
  EXPECT_NE(driver.value()->check({}).find("forgot its currents"), std::string::npos);
  chip_.registers = lit;
  EXPECT_EQ(driver.value()->check({}), "");
  chip_.registers[0x03] = 0;  // output 5 dark, of its current nothing is lost
  EXPECT_NE(driver.value()->check({}).find("forgot its currents"), std::string::npos);
}

TEST_F(LedDriverTest, AHotChipIsPutOutAndStaysOut) {
  auto driver = open();
  ASSERT_TRUE(driver);
  chip_.registers[1] = 0x80;
  EXPECT_NE(driver.value()->check({}).find("put out: their driver is too hot"), std::string::npos);
  EXPECT_EQ(chip_.writes.back(), (Bytes{0x82, 0, 0, 0, 0}));
  chip_.registers[1] = 0;
  EXPECT_NE(driver.value()->check({}).find("start ruffinid again"), std::string::npos);
  EXPECT_EQ(chip_.registers[0x02], 0);
}

TEST_F(LedDriverTest, AWarmGelPutsThemOutBeyondItsLimit) {
  settings_.max_milli_celsius = 60'000;
  auto driver = open();
  ASSERT_TRUE(driver);
  EXPECT_EQ(driver.value()->check(60'000), "");
  EXPECT_NE(driver.value()->check({}).find("the thermometer of [temperature] says nothing"), std::string::npos);
  EXPECT_EQ(chip_.registers[0x02], 0x51) << "lit, as long as it is not known to be too warm";
  EXPECT_NE(driver.value()->check(60'001).find("60001 thousandths of a degree"), std::string::npos);
  EXPECT_EQ(chip_.registers[0x02], 0);
}

TEST_F(LedDriverTest, OpenAndShortedLampsAreNamedButNotUnusedOutputs) {
  auto driver = open();
  ASSERT_TRUE(driver);
  chip_.registers[1] = 0x40;
  chip_.registers[0x46] = 0x88;  // outputs 1 and 3 open: 1 has no lamp
  chip_.registers[0x47] = 0x04;  // output 5 shorted
  EXPECT_EQ(driver.value()->check({}), "lamps at the driver's outputs: 3 open, 5 shorted");
  EXPECT_EQ(chip_.writes.back(), (Bytes{0x81, 0x10})) << "looked for again";
  chip_.registers[1] = 0;
  EXPECT_EQ(driver.value()->check({}), "");
}

}  // namespace
}  // namespace ruffini
