#include "store/own_serial.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

namespace ruffini {
namespace {

namespace fs = std::filesystem;

// Other bytes each time it is asked.
class Counting final : public Random {
 public:
  void fill(std::span<uint8_t> out) override {
    for (uint8_t& byte : out) byte = next_++;
  }

 private:
  uint8_t next_ = 0;
};

class OwnSerial : public testing::Test {
 protected:
  OwnSerial() { fs::remove_all(folder_); }
  ~OwnSerial() override { fs::remove_all(folder_); }

  const fs::path folder_ = fs::path(testing::TempDir()) / ("own_serial" + std::to_string(::getpid()));
  Counting random_;
};

TEST_F(OwnSerial, IsDrawnOnceForEachStore) {
  const std::string first = own_serial(folder_ / "a", random_);
  EXPECT_EQ(first, "01234567");
  EXPECT_EQ(own_serial(folder_ / "a", random_), first);
  EXPECT_EQ(own_serial(folder_ / "b", random_), "89abcdef");
}

TEST_F(OwnSerial, WhatIsSpoiltIsDrawnAnew) {
  fs::create_directories(folder_);
  for (const char* spoilt : {"", "0123456", "012345678", "0123456\n", "0123456\xff"}) {
    std::ofstream(folder_ / "serial", std::ios::binary | std::ios::trunc) << spoilt;
    const std::string drawn = own_serial(folder_, random_);
    EXPECT_EQ(drawn.size(), 8U);
    EXPECT_NE(drawn, spoilt);
    EXPECT_EQ(own_serial(folder_, random_), drawn);
  }
}

// A start that was cut short left its temporary file, or a folder has the name.
TEST_F(OwnSerial, ATemporaryFileIsNoHindranceAndAFolderInTheWayLeavesTheDefault) {
  fs::create_directories(folder_);
  std::ofstream(folder_ / "serial.tmp") << "01";
  EXPECT_EQ(own_serial(folder_, random_), "01234567");
  fs::remove(folder_ / "serial");
  fs::create_directories(folder_ / "serial" / "full");
  EXPECT_EQ(own_serial(folder_, random_), "0000");
  EXPECT_EQ(own_serial("/proc/none", random_), "0000");
}

}  // namespace
}  // namespace ruffini
