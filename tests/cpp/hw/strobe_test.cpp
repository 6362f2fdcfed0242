#include "hw/strobe.h"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <vector>

namespace ruffini {
namespace {

constexpr uint64_t kPeriodUs = 8'000;
constexpr uint64_t kExposureUs = 4'000;  // guard: 500 us
constexpr uint64_t kFirstUs = 1'000'000;

TEST(StrobePlan, NothingIsSwitchedBeforeTheFirstFrame) {
  const StrobePlan plan(kPeriodUs, kExposureUs);
  EXPECT_EQ(plan.next_us(kFirstUs), std::nullopt);
  EXPECT_EQ(plan.lamps_during(kFirstUs), std::nullopt);
}

TEST(StrobePlan, SwitchesAGuardBeforeTheNextExposure) {
  StrobePlan plan(kPeriodUs, kExposureUs);
  plan.record_frame(kFirstUs);
  // The next exposure begins at 1'006'000.
  EXPECT_EQ(plan.next_us(kFirstUs + 3'000), 1'005'500U);
  EXPECT_EQ(plan.next_us(1'005'500), 1'013'500U);
  EXPECT_EQ(plan.next_us(kFirstUs + 100 * kPeriodUs), 1'005'500U + 100 * kPeriodUs);
}

// A camera with jitter, told of a frame two periods late, and a thread that wakes up late by up to 0.4 ms.
TEST(StrobePlan, EveryFrameIsKnownAndTheyAlternate) {
  StrobePlan plan(kPeriodUs, kExposureUs);
  uint32_t seed = 1;
  const auto up_to = [&seed](uint32_t most) {
    seed = seed * 1'664'525 + 1'013'904'223;
    return (seed >> 8) % (most + 1);
  };
  bool is_on = true;
  uint64_t done_us = 0;
  std::vector<std::optional<bool>> said;
  for (uint64_t k = 0; k < 200; ++k) {
    const uint64_t arrival_us = kFirstUs + (k + 2) * kPeriodUs;
    // Whatever is due before this arrival.
    for (auto next = plan.next_us(done_us); next && *next < arrival_us; next = plan.next_us(done_us)) {
      is_on = !is_on;
      plan.switched(*next + up_to(400), is_on);
      done_us = *next + kPeriodUs / 4;
    }
    const uint64_t middle_us = kFirstUs + k * kPeriodUs + up_to(100);
    plan.record_frame(middle_us);
    if (done_us == 0) done_us = arrival_us;
    if (k >= 4) said.push_back(plan.lamps_during(middle_us));
  }
  for (size_t i = 0; i < said.size(); ++i) {
    ASSERT_TRUE(said[i].has_value()) << i;
    if (i > 0) {
      ASSERT_NE(*said[i], *said[i - 1]) << i;
    }
  }
}

TEST(StrobePlan, ASwitchWithinTheExposureOrTheReadOutMakesTheFrameUnknown) {
  StrobePlan plan(kPeriodUs, kExposureUs);
  plan.switched(kFirstUs - 2'000, false);  // the moment at which the exposure begins: in time
  EXPECT_EQ(plan.lamps_during(kFirstUs), false);
  plan.switched(kFirstUs + 5'000, true);  // the last moment at which rows are read
  EXPECT_EQ(plan.lamps_during(kFirstUs), std::nullopt);
  StrobePlan late(kPeriodUs, kExposureUs);
  late.switched(kFirstUs - 2'001, true);
  late.switched(kFirstUs + 5'001, false);
  EXPECT_EQ(late.lamps_during(kFirstUs), true);
  late.switched(kFirstUs + 20'000, true);
  EXPECT_EQ(late.lamps_during(kFirstUs), true) << "long after, still known";
  for (uint64_t i = 0; i < 16; ++i) late.switched(kFirstUs + 30'000 + i, i % 2 == 0);
  EXPECT_EQ(late.lamps_during(kFirstUs), std::nullopt) << "too long ago";
}

class CountedLine final : public OutputLine {
 public:
  bool set(bool is_on) override {
    is_on_ = is_on;
    ++n;
    return true;
  }
  std::atomic<int> n{0};  // NOLINT(misc-non-private-member-variables-in-classes)

 private:
  std::atomic<bool> is_on_{true};
};

// The thread itself: it switches when told of frames, not before, and ends at once.
TEST(Strobe, SwitchesOnceItIsToldOfAFrame) {
  CountedLine line;
  {
    Strobe strobe(line, 2'000, 500);
    EXPECT_EQ(line.n, 0);
    const auto now = std::chrono::steady_clock::now().time_since_epoch();
    const auto now_us = static_cast<uint64_t>(std::chrono::duration_cast<std::chrono::microseconds>(now).count());
    EXPECT_EQ(strobe.record_frame(now_us), std::nullopt);
    while (line.n < 20) std::this_thread::yield();
  }
  const int n = line.n;
  EXPECT_GE(n, 20);
}

}  // namespace
}  // namespace ruffini
