#include "link/stall_watch.h"

#include <gtest/gtest.h>

#include <initializer_list>

namespace ruffini {
namespace {

constexpr uint64_t kPeriodUs = 16'667;

// Frames one interval apart, looked at each 2 ms; the time of the last one.
uint64_t run(StallWatch& watch, uint64_t n_frames, uint64_t interval_us, uint64_t now_us, uint64_t first = 0) {
  for (uint64_t i = 1; i <= n_frames; ++i) {
    for (uint64_t at = 0; at + 2'000 < interval_us; at += 2'000) EXPECT_FALSE(watch.update(first + i - 1, now_us + at));
    now_us += interval_us;
    EXPECT_FALSE(watch.update(first + i, now_us));
  }
  return now_us;
}

TEST(StallWatch, SaysSoAfterThreeIntervalsAndWhenItIsOver) {
  StallWatch watch(kPeriodUs);
  const uint64_t now_us = run(watch, 100, kPeriodUs, 1'000);
  EXPECT_FALSE(watch.update(100, now_us + 3 * kPeriodUs - 2'000));
  EXPECT_TRUE(watch.update(100, now_us + 3 * kPeriodUs + 2'000));
  EXPECT_TRUE(watch.update(100, now_us + 60'000'000));
  EXPECT_FALSE(watch.update(101, now_us + 60'002'000));
  EXPECT_LT(watch.limit_us(), 3 * kPeriodUs + 1'000) << "the stall is not taken for an interval";
}

TEST(StallWatch, ACameraThatIsSlowerThanItsBoardSaysIsNotStalled) {
  StallWatch watch(kPeriodUs);
  uint64_t now_us = 1'000;
  for (uint64_t i = 0; i < 30; ++i) now_us = run(watch, 1, kPeriodUs + i * 1'500, now_us, i);
  EXPECT_FALSE(watch.update(30, now_us + 100'000));
  EXPECT_TRUE(watch.update(30, now_us + 250'000));
}

TEST(StallWatch, ACameraOfATenthOfItsBoardsRateStallsFourTimesAndIsThenTheUsual) {
  StallWatch watch(10'000);
  int n_stalls = 0;
  uint64_t now_us = 1'000;
  bool was_stalled = false;
  for (uint64_t i = 0; i < 40; ++i) {
    for (int k = 0; k < 50; ++k, now_us += 2'000) {
      const bool is_stalled = watch.update(i, now_us);
      n_stalls += is_stalled && !was_stalled ? 1 : 0;
      was_stalled = is_stalled;
    }
  }
  EXPECT_EQ(n_stalls, StallWatch::kMaxLateInARow);
  EXPECT_NEAR(static_cast<double>(watch.limit_us()), 300'000.0, 10'000.0);
  EXPECT_TRUE(watch.update(39, now_us + 250'000));
}

TEST(StallWatch, ACameraThatStallsNowAndThenKeepsItsLimit) {
  StallWatch watch(kPeriodUs);
  uint64_t now_us = 1'000;
  for (uint64_t i = 0; i < 20; ++i) {
    now_us = run(watch, 1, kPeriodUs, now_us, 2 * i);
    EXPECT_TRUE(watch.update(2 * i + 1, now_us + 90'000));
    now_us += 92'000;
    EXPECT_FALSE(watch.update(2 * i + 2, now_us));
  }
  EXPECT_LT(watch.limit_us(), 3 * kPeriodUs + 1'000);
}

TEST(StallWatch, NoCameraIsSoSlowThatAForceGrowsOldUnmarked) {
  for (const uint64_t interval_us :
       std::initializer_list<uint64_t>{450'000, 600'000, 800'000, 1'000'000, 1'150'000, 2'800'000, 8'000'000}) {
    StallWatch watch(kPeriodUs);
    uint64_t now_us = 1'000;
    for (uint64_t i = 0; i < 60; ++i) {
      const uint64_t step_us = i < 30 ? std::min<uint64_t>(interval_us, 1'000'000) : interval_us;
      for (uint64_t at_us = 0; at_us < step_us; at_us += 10'000) (void)watch.update(i, now_us + at_us);
      now_us += step_us;
      if (i > 0) {
        EXPECT_LE(watch.limit_us(), StallWatch::kOldestUs) << interval_us << " us, frame " << i;
      }
    }
    (void)watch.update(60, now_us);
    EXPECT_TRUE(watch.update(60, now_us + StallWatch::kOldestUs + 1));
  }
}

TEST(StallWatch, ABoardThatWantsOneFrameInTwoSecondsIsWaitedFor) {
  StallWatch watch(2'000'000);
  (void)watch.update(0, 1'000);
  (void)watch.update(1, 2'001'000);
  EXPECT_FALSE(watch.update(1, 2'001'000 + 5'900'000));
  EXPECT_TRUE(watch.update(1, 2'001'000 + 6'100'000));
}

TEST(StallWatch, AFastCameraHasTimeForAHiccup) {
  StallWatch watch(2'000);
  const uint64_t now_us = run(watch, 100, 2'000, 1'000);
  EXPECT_FALSE(watch.update(100, now_us + 24'000));
  EXPECT_TRUE(watch.update(100, now_us + 26'000));
}

TEST(StallWatch, ACameraThatStartsHasTwoSecondsAndOneThatIsNotWantedHasAllTime) {
  StallWatch watch(kPeriodUs);
  EXPECT_FALSE(watch.update(0, 1'000));
  EXPECT_FALSE(watch.update(0, 1'900'000));
  EXPECT_TRUE(watch.update(0, 2'100'000));
  watch.suspend(9'000'000);
  EXPECT_FALSE(watch.update(0, 9'100'000));
}

}  // namespace
}  // namespace ruffini
