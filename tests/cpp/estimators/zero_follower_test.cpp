#include "estimators/zero_follower.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <random>

namespace ruffini {
namespace {

constexpr uint64_t kPeriodUs = 50'000;  // 20 Hz, so that hours are short
constexpr int kFramesOfHour = 72'000;

NodeDisplacement node_of(int raw_z) {
  return {.x = {},
          .y = DisplacementUm::from_raw(static_cast<int16_t>(-raw_z)),
          .z = DisplacementUm::from_raw(static_cast<int16_t>(raw_z))};
}

// One node's z, in nanometres, after the follower has seen `n` more frames of it.
class Pad {
 public:
  int shown_nm(double z_nm, int n, bool may_press = false) {
    NodeDisplacement node;
    for (int i = 0; i < n; ++i) {
      now_us_ += kPeriodUs;
      node = node_of(static_cast<int>(std::lround((z_nm + 250 * noise_(random_)) / 125)));
      follower.run({&node, 1}, may_press, now_us_);
    }
    EXPECT_LE(std::abs(node.y.raw() + node.z.raw()), 1);
    NodeDisplacement plain = node_of(static_cast<int>(std::lround(z_nm / 125)));
    follower.run({&plain, 1}, true, now_us_);
    return 125 * plain.z.raw();
  }
  ZeroFollower follower{1};

 private:
  uint64_t now_us_ = 1;
  std::mt19937 random_{7};
  std::normal_distribution<double> noise_;
};

TEST(ZeroFollower, CreepOfAMicrometreAnHourIsGoneFromWhatIsShown) {
  Pad pad;
  for (int hour = 1; hour <= 8; ++hour) {
    for (int part = 1; part <= 60; ++part) {
      EXPECT_LE(std::abs(pad.shown_nm(1'000.0 * (hour - 1) + 1'000.0 * part / 60, kFramesOfHour / 60)), 250);
    }
    EXPECT_NEAR(static_cast<double>(pad.follower.moved_nm()), 1'000 * hour, 200);
  }
  EXPECT_FALSE(pad.follower.is_at_limit());
}

TEST(ZeroFollower, FasterCreepIsFollowedAtItsBoundAndNoFartherThanItsLimit) {
  Pad pad;
  EXPECT_NEAR(pad.shown_nm(-40'000, kFramesOfHour), -40'000 + 2'000, 250);
  EXPECT_NEAR(static_cast<double>(pad.follower.moved_nm()), ZeroFollower::kNmPerHour, 100);
  EXPECT_NEAR(pad.shown_nm(-40'000, 5 * kFramesOfHour), -40'000 + 10'000, 125);
  EXPECT_TRUE(pad.follower.is_at_limit());
  EXPECT_NEAR(pad.shown_nm(0, kFramesOfHour), 10'000 - 2'000, 250) << "it comes back as slowly";
}

TEST(ZeroFollower, ALoadThatCountsAsATouchIsNeverLearned) {
  Pad pad;
  EXPECT_NEAR(pad.shown_nm(-5'000, 8 * kFramesOfHour, true), -5'000, 125);
  EXPECT_EQ(pad.follower.moved_nm(), 0);
  // Nor is one that comes within each second.
  for (int i = 0; i < 2'000; ++i) {
    (void)pad.shown_nm(-5'000, 19);
    (void)pad.shown_nm(-5'000, 1, true);
  }
  EXPECT_EQ(pad.follower.moved_nm(), 0);
}

TEST(ZeroFollower, WithoutTimesOrAfterAZeroNothingIsTaken) {
  Pad pad;
  (void)pad.shown_nm(3'000, kFramesOfHour);
  EXPECT_GT(pad.follower.moved_nm(), 1'500);
  pad.follower.forget();
  EXPECT_EQ(pad.follower.moved_nm(), 0);
  EXPECT_EQ(pad.shown_nm(3'000, 1), 3'000);
  NodeDisplacement node = node_of(80);
  for (int i = 0; i < 1'000; ++i) pad.follower.run({&node, 1}, false, 0);
  EXPECT_EQ(pad.follower.moved_nm(), 0);
  EXPECT_EQ(node.z.raw(), 80);
}

TEST(ZeroFollower, ASecondWithAGapIsNotLearned) {
  ZeroFollower follower(1);
  NodeDisplacement node = node_of(8);
  for (uint64_t i = 0; i < 10; ++i) follower.run({&node, 1}, false, 1 + i * kPeriodUs);
  follower.run({&node, 1}, false, 10'000'000);
  EXPECT_EQ(follower.moved_nm(), 0);
}

TEST(ZeroFollower, AfterAZeroItFollowsFromThere) {
  Pad pad;
  (void)pad.shown_nm(3'000, kFramesOfHour);
  pad.follower.forget();
  EXPECT_NEAR(pad.shown_nm(0, 60), 0, 125);
  EXPECT_LT(pad.follower.moved_nm(), 10);
}

}  // namespace
}  // namespace ruffini
