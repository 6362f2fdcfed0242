#include "base/latest.h"

#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <thread>

namespace ruffini {
namespace {

TEST(Latest, TheNewestIsTakenOnce) {
  Latest<int> latest;
  EXPECT_EQ(latest.take(), nullptr);
  for (const int value : {1, 2}) {
    latest.draft() = value;
    latest.publish();
  }
  const int* taken = latest.take();
  ASSERT_NE(taken, nullptr);
  EXPECT_EQ(*taken, 2);
  EXPECT_EQ(latest.take(), nullptr);
  latest.draft() = 3;  // does not touch what the reader holds
  latest.publish();
  EXPECT_EQ(*taken, 2);
  EXPECT_EQ(*latest.take(), 3);
}

// What is read is whole, and never older than what was read before; the last one arrives.
TEST(Latest, TwoThreadsNeitherTearNorGoBack) {
  constexpr uint64_t kLast = 200'000;
  Latest<std::array<uint64_t, 8>> latest;
  std::thread writer([&] {
    for (uint64_t i = 1; i <= kLast; ++i) {
      latest.draft().fill(i);
      latest.publish();
    }
  });
  uint64_t seen = 0;
  uint64_t n_wrong = 0;
  while (seen < kLast) {
    const auto* taken = latest.take();
    if (taken == nullptr) continue;
    for (const uint64_t value : *taken) n_wrong += value == taken->front() ? 0U : 1U;
    n_wrong += taken->front() > seen ? 0U : 1U;
    seen = taken->front();
  }
  writer.join();
  EXPECT_EQ(n_wrong, 0U);
}

}  // namespace
}  // namespace ruffini
