#include "hw/liveness.h"

#include <gtest/gtest.h>

#include <string>

namespace ruffini {
namespace {

constexpr uint64_t kWatchdogUs = 3'000'000;

class LivenessTest : public testing::Test {
 protected:
  // A second of 100 turns, in which the threads in `moving` move on; how often the watchdog was fed.
  int second(const std::string& moving, const std::string& expected = "abc") {
    int n_fed = 0;
    for (int turn = 0; turn < 100; ++turn) {
      now_us_ += 10'000;
      for (size_t i = 0; i < 3; ++i) {
        threads_[i].count += moving.find(kNames[i]) != std::string::npos ? 1U : 0U;
        threads_[i].is_expected = expected.find(kNames[i]) != std::string::npos;
      }
      n_fed += liveness_.update(threads_, now_us_) ? 1 : 0;
    }
    return n_fed;
  }

  static constexpr const char* kNames[3] = {"a", "b", "c"};
  std::array<ThreadProgress, 3> threads_ = {{{"a"}, {"b"}, {"c"}}};
  uint64_t now_us_ = 0;
  Liveness<3> liveness_{kWatchdogUs};
};

TEST_F(LivenessTest, FeedsThreeTimesAsOftenAsWanted) {
  int n_fed = 0;
  for (int i = 0; i < 30; ++i) n_fed += second("abc");
  EXPECT_GE(n_fed, 29);
  EXPECT_LE(n_fed, 31);
  EXPECT_STREQ(liveness_.stuck(), "");
}

TEST_F(LivenessTest, OneThreadThatStandsStillIsEnoughToStarve) {
  for (const std::string stuck : {"a", "b", "c"}) {
    for (int i = 0; i < 3; ++i) (void)second("abc");
    std::string moving = "abc";
    moving.erase(moving.find(stuck), 1);
    (void)second(moving);  // it moved on within this one's first part
    for (int i = 0; i < 10; ++i) EXPECT_EQ(second(moving), 0) << stuck;
    EXPECT_EQ(liveness_.stuck(), stuck);
    EXPECT_GE(second("abc"), 1) << "and is fed again when it goes on";
    EXPECT_STREQ(liveness_.stuck(), "");
  }
}

TEST_F(LivenessTest, WhatIsNotExpectedMayStandStill) {
  int n_fed = 0;
  for (int i = 0; i < 10; ++i) n_fed += second("c", "c");
  EXPECT_GE(n_fed, 9);
}

TEST_F(LivenessTest, NobodyWhoAsksIsNotFed) {
  Liveness<3> quiet{0};
  for (uint64_t i = 1; i < 1'000; ++i)
    EXPECT_FALSE(quiet.update({{{"a", i, true}, {"b", i, true}, {"c", i, true}}}, i * 10'000));
}

}  // namespace
}  // namespace ruffini
