#include "hw/thermometer.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

namespace ruffini {
namespace {

std::optional<int32_t> said(const std::string& text) {
  // Tests are processes that run side by side.
  const std::string path = testing::TempDir() + "thermometer_test_temp1_input" + std::to_string(::getpid());
  std::ofstream(path) << text;
  return Thermometer(path).milli_celsius();
}

TEST(Thermometer, ReadsThousandthsOfADegree) {
  EXPECT_EQ(said("45123\n"), 45'123);
  EXPECT_EQ(said("-5000\n"), -5'000);
  EXPECT_EQ(said("0"), 0);
}

TEST(Thermometer, SaysNothingOfWhatIsNoTemperature) {
  for (const char* text : {"", "\n", "warm\n", "45.1\n", "300001\n", "-100001\n", "99999999999\n"}) {
    EXPECT_EQ(said(text), std::nullopt) << text;
  }
}

TEST(Thermometer, SaysNothingWithoutAFile) {
  EXPECT_EQ(Thermometer("").milli_celsius(), std::nullopt);
  EXPECT_EQ(Thermometer("/nowhere/temp1_input").milli_celsius(), std::nullopt);
  EXPECT_EQ(Thermometer(testing::TempDir()).milli_celsius(), std::nullopt) << "a folder";
}

}  // namespace
}  // namespace ruffini
