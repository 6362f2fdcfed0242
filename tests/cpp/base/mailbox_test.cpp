#include "base/mailbox.h"

#include <gtest/gtest.h>

#include <thread>
#include <vector>

namespace ruffini {
namespace {

TEST(IndexMailbox, TheNewestWinsAndTheOldGoesBack) {
  IndexMailbox box;
  EXPECT_EQ(box.take(), std::nullopt);
  EXPECT_EQ(box.post(3), std::nullopt);
  EXPECT_EQ(box.post(4), 3);
  EXPECT_EQ(box.take(), 4);
  EXPECT_EQ(box.take(), std::nullopt);
}

TEST(IndexMailbox, ClosedTakesNothingAndEndsEveryWait) {
  IndexMailbox box;
  box.post(1);
  std::thread full([&] {
    IndexMailbox empty;
    std::thread closer([&] { empty.close(); });
    empty.wait_full();
    closer.join();
  });
  full.join();
  EXPECT_EQ(box.close(), 1);
  EXPECT_TRUE(box.is_closed());
  EXPECT_EQ(box.post(2), 2);
  box.wait_empty();
  box.wait_full();
}

// Every index that was posted is either taken or given back, once.
TEST(IndexMailbox, TwoThreadsNeitherLoseNorDouble) {
  constexpr int kPosts = 50'000;
  IndexMailbox box;
  std::vector<int> seen(kPosts);
  std::thread taker([&] {
    while (true) {
      box.wait_full();
      if (const auto index = box.take()) {
        ++seen[static_cast<size_t>(*index)];
      } else if (box.is_closed()) {
        return;
      }
    }
  });
  std::vector<int> back(kPosts);
  for (int i = 0; i < kPosts; ++i) {
    if (const auto replaced = box.post(i)) ++back[static_cast<size_t>(*replaced)];
  }
  if (const auto left = box.close()) ++back[static_cast<size_t>(*left)];
  taker.join();
  for (size_t i = 0; i < seen.size(); ++i) ASSERT_EQ(seen[i] + back[i], 1) << i;
}

// Both sides sleep for the other one, over and over: a wake-up that is lost would hang here.
TEST(IndexMailbox, WhoSleepsIsAlwaysWoken) {
  constexpr int kPosts = 20'000;
  IndexMailbox box;
  int64_t sum = 0;
  std::thread taker([&] {
    for (int n = 0; n < kPosts; ++n) {
      box.wait_full();
      sum += box.take().value();
    }
  });
  for (int i = 0; i < kPosts; ++i) {
    EXPECT_EQ(box.post(i), std::nullopt);
    box.wait_empty();
  }
  taker.join();
  EXPECT_EQ(sum, int64_t{kPosts} * (kPosts - 1) / 2);
}

}  // namespace
}  // namespace ruffini
