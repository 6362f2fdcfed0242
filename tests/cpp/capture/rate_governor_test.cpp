#include "capture/rate_governor.h"

#include <gtest/gtest.h>

namespace ruffini {
namespace {

constexpr uint64_t kPeriodUs = 16'667;

// A second of frames, the last `n_slow` of each ten of which take `slow_us`; returns the divisor after it.
class Governed {
 public:
  Governed() { EXPECT_EQ(governor_.update(now_us_, 5'000, false), 1U) << "here the first window begins"; }
  uint32_t second(uint64_t busy_us, int n_slow = 10, bool is_throttled = false) {
    const uint32_t n_frames = 60 / divisor_;
    const uint64_t interval_us = kPeriodUs * divisor_;
    for (uint32_t i = 0; i < n_frames; ++i) {
      now_us_ += interval_us;
      const bool is_slow = i % 10 >= static_cast<uint32_t>(10 - n_slow);
      divisor_ = governor_.update(now_us_, is_slow ? busy_us : 5'000, is_throttled);
    }
    return divisor_;
  }
  uint32_t seconds(int n, uint64_t busy_us, int n_slow = 10, bool is_throttled = false) {
    uint32_t divisor = divisor_;
    for (int i = 0; i < n; ++i) divisor = second(busy_us, n_slow, is_throttled);
    return divisor;
  }

 private:
  RateGovernor governor_{kPeriodUs};
  uint64_t now_us_ = 5'000'000;
  uint32_t divisor_ = 1;
};

TEST(RateGovernor, FramesWithinTheirIntervalKeepTheRate) {
  Governed governed;
  EXPECT_EQ(governed.seconds(60, kPeriodUs), 1U);
}

TEST(RateGovernor, ASecondOfSlowFramesIsForgivenTwoAreNot) {
  Governed governed;
  EXPECT_EQ(governed.seconds(1, 20'000), 1U);
  EXPECT_EQ(governed.seconds(2, 5'000), 1U);
  EXPECT_EQ(governed.seconds(2, 20'000), 2U);
}

TEST(RateGovernor, HalfOfTheFramesMayBeLate) {
  Governed governed;
  EXPECT_EQ(governed.seconds(20, 20'000, 5), 1U);
  EXPECT_EQ(governed.seconds(3, 20'000, 7), 2U);
}

// Between 3/4 of the interval and the interval nothing changes, from either side.
TEST(RateGovernor, TheRateReturnsAfterTenFastSecondsAndNotBefore) {
  Governed governed;
  EXPECT_EQ(governed.seconds(2, 20'000), 2U);
  EXPECT_EQ(governed.seconds(60, 14'000), 2U) << "within the interval, but without a margin";
  EXPECT_EQ(governed.seconds(9, 12'000), 2U);
  EXPECT_EQ(governed.seconds(1, 14'000), 2U) << "begins again";
  EXPECT_EQ(governed.seconds(9, 12'000), 2U);
  EXPECT_EQ(governed.seconds(1, 12'000), 1U);
  EXPECT_EQ(governed.seconds(60, 14'000), 1U);
}

TEST(RateGovernor, AThrottledComputerGetsHalfTheFramesUntilItIsNot) {
  Governed governed;
  EXPECT_EQ(governed.seconds(3, 5'000, 10, true), 2U);
  EXPECT_EQ(governed.seconds(60, 5'000, 10, true), 2U);
  EXPECT_EQ(governed.seconds(9, 5'000), 2U);
  EXPECT_EQ(governed.seconds(2, 5'000), 1U);
}

TEST(RateGovernor, AStallOfTheCameraIsNoReason) {
  RateGovernor governor(kPeriodUs);
  EXPECT_EQ(governor.update(1'000'000, 5'000, false), 1U);
  EXPECT_EQ(governor.update(61'000'000, 5'000, false), 1U);
  EXPECT_EQ(governor.update(121'000'000, 5'000, false), 1U);
}

}  // namespace
}  // namespace ruffini
