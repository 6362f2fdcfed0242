#include "capture/frame_order.h"

#include <gtest/gtest.h>

#include <vector>

namespace ruffini {
namespace {

constexpr uint64_t kPeriodUs = 10'000;

// A camera of 100 Hz; frame n was captured at (n + 100) periods and arrives 5 ms later.
struct Line {
  FrameOrder order;
  uint64_t now_us = 0;
  uint64_t number = 0;
  uint64_t capture_us = 0;

  FrameOrder::Outcome give(uint64_t n) { return give(n, (n + 100) * kPeriodUs); }
  FrameOrder::Outcome give(uint64_t n, uint64_t at_us) { return give(n, at_us, (n + 100) * kPeriodUs + 5'000); }
  FrameOrder::Outcome give(uint64_t n, uint64_t at_us, uint64_t now) {
    number = n;
    capture_us = at_us;
    now_us = now;
    return order.check(number, capture_us, now_us);
  }
};

TEST(FrameOrder, GoodFramesStayAsTheyAre) {
  Line line;
  for (uint64_t n = 7; n < 1'000; ++n) {
    const auto said = line.give(n);
    EXPECT_TRUE(said.is_used);
    EXPECT_EQ(said.n_missed, 0U);
    EXPECT_FALSE(said.is_time_wrong);
    EXPECT_EQ(line.number, n);
    EXPECT_EQ(line.capture_us, (n + 100) * kPeriodUs);
  }
}

TEST(FrameOrder, GapsAreCountedExactly) {
  Line line;
  (void)line.give(1);
  EXPECT_EQ(line.give(3).n_missed, 1U);
  EXPECT_EQ(line.give(4).n_missed, 0U);
  EXPECT_EQ(line.give(40).n_missed, 35U);
}

TEST(FrameOrder, ANumberThatCameBeforeIsNotUsedAndTheNextOneIs) {
  Line line;
  for (const uint64_t n : {10U, 11U}) EXPECT_TRUE(line.give(n).is_used);
  for (const uint64_t n : {11U, 10U, 11U, 11U}) EXPECT_FALSE(line.give(n, 5'000'000).is_used) << n;
  EXPECT_EQ(line.give(12).n_missed, 0U);
}

TEST(FrameOrder, ACameraThatStartsAgainGoesOnWithItsThirdFrame) {
  Line line;
  for (uint64_t n = 0; n <= 500; ++n) (void)line.give(n);
  const auto at = [](uint64_t n) { return (n + 700) * kPeriodUs; };
  EXPECT_FALSE(line.give(0, at(0), at(0)).is_used);
  EXPECT_FALSE(line.give(1, at(1), at(1)).is_used);
  EXPECT_TRUE(line.give(2, at(2), at(2)).is_used);
  EXPECT_EQ(line.number, 501U);
  EXPECT_EQ(line.give(5, at(5), at(5)).n_missed, 2U);
  EXPECT_EQ(line.number, 504U);
}

TEST(FrameOrder, TimesOnlyGoForwardAndTheWrongOnesAreSaid) {
  Line line;
  (void)line.give(1);
  uint64_t before = line.capture_us;
  uint64_t n = 2;
  for (const uint64_t wrong : {uint64_t{0}, before, before - 1, uint64_t{1} << 63, UINT64_MAX,
                               uint64_t{107 * kPeriodUs + 5'000 + FrameOrder::kAheadUs + 1}}) {
    const auto said = line.give(n, wrong);
    EXPECT_TRUE(said.is_used);
    EXPECT_TRUE(said.is_time_wrong) << wrong;
    EXPECT_EQ(line.capture_us, line.now_us);
    EXPECT_GT(line.capture_us, before);
    before = line.capture_us;
    ++n;
  }
  EXPECT_FALSE(line.give(n).is_time_wrong) << "and is right again at once";
}

// What a camera held back while the device stood still is old, not wrong; a clock that lags for good is wrong.
TEST(FrameOrder, OldFramesAreNotUsedUnlessTheyGoOnBeingOld) {
  Line line;
  (void)line.give(1);
  const uint64_t now = line.now_us + 10'000'000;
  for (uint64_t n = 2; n < 2 + FrameOrder::kMaxOld; ++n) EXPECT_FALSE(line.give(n, (n + 100) * kPeriodUs, now).is_used);
  Line lagging = line;
  const auto fresh = line.give(1'001, now, now);
  EXPECT_TRUE(fresh.is_used);
  EXPECT_EQ(fresh.n_missed, 999U);
  EXPECT_FALSE(fresh.is_time_wrong);
  const auto said = lagging.give(2 + FrameOrder::kMaxOld, 1'500'000, now);
  EXPECT_TRUE(said.is_used);
  EXPECT_TRUE(said.is_time_wrong);
  EXPECT_EQ(lagging.capture_us, now);
}

TEST(FrameOrder, WithoutAClockTimesGoForwardNoMore) {
  Line line;
  for (uint64_t n = 0; n < 3; ++n) EXPECT_FALSE(line.give(n, 1 + n, 0).is_time_wrong);
  EXPECT_TRUE(line.give(3, 3, 0).is_time_wrong);
  EXPECT_EQ(line.capture_us, 4U);
}

}  // namespace
}  // namespace ruffini
