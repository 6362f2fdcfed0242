#include "hw/system.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>

namespace ruffini {
namespace {

TEST(System, TheClockDoesNotGoBack) {
  const SystemClock clock;
  const uint64_t first = clock.now_us();
  EXPECT_GT(first, 0U);
  EXPECT_GE(clock.now_us(), first);
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
