#include "link/line_latency.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

namespace ruffini {
namespace {

TEST(LineLatency, NoFrameHasNoLatency) {
  const LineLatency none;
  EXPECT_EQ(none.n_frames(), 0U);
  EXPECT_EQ(none.percentile_us(500), 0U);
  EXPECT_EQ(none.max_us(), 0U);
}

// Against the sorted latencies themselves, over every octave that there is.
TEST(LineLatency, PercentilesAreThoseOfTheSortedLatencies) {
  for (uint64_t scale = 1; scale <= 4'096; scale *= 2) {
    LineLatency latency;
    std::vector<uint64_t> sorted;
    uint64_t exposed_us = 1'000'000;
    uint64_t state = scale;
    for (int i = 0; i < 2'000; ++i) {
      state = state * 6'364'136'223'846'793'005U + 1'442'695'040'888'963'407U;
      const uint64_t us = (state >> 33) % 4'000 * scale;
      sorted.push_back(us);
      exposed_us += 20'000'000;
      latency.add(exposed_us, exposed_us + us);
    }
    std::sort(sorted.begin(), sorted.end());
    EXPECT_EQ(latency.n_frames(), 2'000U);
    EXPECT_EQ(latency.max_us(), sorted.back());
    for (const uint32_t per_mille : {1U, 500U, 990U, 999U, 1'000U}) {
      const uint64_t truth = sorted[2 * per_mille - 1];
      EXPECT_GE(latency.percentile_us(per_mille), truth) << scale << " " << per_mille;
      EXPECT_LE(latency.percentile_us(per_mille), truth + truth / 32) << scale << " " << per_mille;
    }
  }
}

TEST(LineLatency, OneLateFrameInAThousandIsOnlyTheLargest) {
  LineLatency latency;
  for (uint64_t i = 1; i <= 1'000; ++i) latency.add(i * 16'667, i * 16'667 + (i == 400 ? 30'000 : 50));
  EXPECT_EQ(latency.percentile_us(500), 50U);
  EXPECT_EQ(latency.percentile_us(999), 50U);
  EXPECT_EQ(latency.percentile_us(1'000), 30'000U);
  EXPECT_EQ(latency.max_us(), 30'000U);
}

TEST(LineLatency, TheLastMessageOfAFrameCountsOnce) {
  LineLatency latency;
  latency.add(1'000, 1'010);
  latency.add(1'000, 1'040);
  latency.add(2'000, 2'020);
  latency.add(1'000, 2'030);  // a message that waited behind the next frame's
  EXPECT_EQ(latency.n_frames(), 2U);
  EXPECT_EQ(latency.percentile_us(500), 20U);
  EXPECT_EQ(latency.percentile_us(1'000), 40U);
}

TEST(LineLatency, AStampAheadOfTheClockIsNoneAndAHangUpIsTheLongest) {
  LineLatency latency;
  latency.add(1'000, 900);
  EXPECT_EQ(latency.percentile_us(1'000), 0U);
  latency.add(2'000, 2'000 + 4 * LineLatency::kMaxUs);
  EXPECT_EQ(latency.percentile_us(1'000), LineLatency::kMaxUs);
  latency.reset();
  EXPECT_EQ(latency.n_frames(), 0U);
  EXPECT_EQ(latency.max_us(), 0U);
}

}  // namespace
}  // namespace ruffini
