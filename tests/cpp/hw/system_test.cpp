#include "hw/system.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>

namespace ruffini {
namespace {

TEST(System, TheClockDoesNotGoBack) {
  const SystemClock clock;
  const uint64_t first = clock.now_us();
  EXPECT_GT(first, 0U);
  EXPECT_GE(clock.now_us(), first);
}

TEST(System, TheClockOfAFileIsWhatTheFileSays) {
  const std::string path = testing::TempDir() + "clock" + std::to_string(::getpid());
  EXPECT_FALSE(FileClock::open(path)) << "it is not there";
  std::ofstream(path) << "seven..";
  EXPECT_FALSE(FileClock::open(path)) << "it is too short";
  const auto write = [&](uint64_t us) {
    std::fstream(path, std::ios::in | std::ios::out | std::ios::binary).write(reinterpret_cast<char*>(&us), sizeof(us));
  };
  std::ofstream(path) << "12345678";
  write(41);
  const std::unique_ptr<Clock> clock = FileClock::open(path).value();
  EXPECT_EQ(clock->now_us(), 41U);
  write(0x0102030405060708);
  EXPECT_EQ(clock->now_us(), 0x0102030405060708U);
  std::filesystem::remove(path);
}

TEST(System, RandomBytesFillAllAndDiffer) {
  SystemRandom random;
  std::array<std::array<uint8_t, 1'000>, 2> drawn{};
  for (auto& each : drawn) random.fill(each);
  EXPECT_NE(drawn[0], drawn[1]);
  const bool is_filled = std::any_of(drawn[0].end() - 16, drawn[0].end(), [](uint8_t byte) { return byte != 0; });
  EXPECT_TRUE(is_filled) << "or once in 2^128";
}

}  // namespace
}  // namespace ruffini
