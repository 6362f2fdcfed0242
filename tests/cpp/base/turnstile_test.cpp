#include "base/turnstile.h"

#include <gtest/gtest.h>

#include <thread>
#include <vector>

namespace ruffini {
namespace {

// `seen` has no lock: the turnstile orders the threads.
TEST(Turnstile, TwoThreadsPassByTurns) {
  constexpr uint32_t kFrames = 20'000;
  Turnstile turn;
  std::vector<uint32_t> seen;
  const auto pass_each_second = [&](uint32_t first) {
    for (uint32_t number = first; number < kFrames; number += 2) {
      turn.wait_for(number);
      seen.push_back(number);
      turn.pass();
    }
  };
  std::thread odd([&] { pass_each_second(1); });
  pass_each_second(0);
  odd.join();
  ASSERT_EQ(seen.size(), kFrames);
  for (uint32_t i = 0; i < kFrames; ++i) ASSERT_EQ(seen[i], i);
}

TEST(Turnstile, WaitsForAllFramesBefore) {
  Turnstile turn;
  bool has_passed = false;
  std::thread late([&] {
    turn.wait_for(2);
    EXPECT_TRUE(has_passed);
  });
  turn.wait_for(0);
  turn.pass();
  std::this_thread::sleep_for(std::chrono::milliseconds(5));
  has_passed = true;
  turn.pass();
  late.join();
}

}  // namespace
}  // namespace ruffini
