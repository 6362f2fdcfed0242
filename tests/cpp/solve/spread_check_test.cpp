#include "solve/spread_check.h"

#include <gtest/gtest.h>

#include "support/held_calibration.h"

namespace ruffini {
namespace {

constexpr GridSize kNodes{3, 2};
const std::vector<NodePlace> kPlaces = {{-1'000, -500}, {0, -500}, {1'000, -500},
                                        {-1'000, 500},  {0, 500},  {1'000, 500}};

class File {
 public:
  explicit File(int32_t limit = 100'000, int32_t first = 3) {
    std::vector<int32_t> spread(18, 0);
    spread[2] = first;  // z of node 0
    spread[9] = -5;     // x of node 3
    held_ = test::held(test::CalibrationBytes()
                           .meta("kinds", "support")
                           .tensor("support.spread", "I32", {18}, spread)
                           .tensor("support.spread_limit", "I32", {1}, std::vector<int32_t>{limit}));
  }
  [[nodiscard]] Result<SpreadCheck> load() const { return SpreadCheck::load(held_->get(), kNodes, kPlaces); }

 private:
  std::shared_ptr<const CalibrationFile> held_;
};

constexpr size_t kXOfNode2 = 6;

// Node 2 moved by dx along x, and node 0 pressed. A force at node 1 spreads nothing.
bool is_explained(const SpreadCheck& check, int16_t dx, int32_t fz, bool is_pressed = true) {
  std::vector<int16_t> u(18);
  u[kXOfNode2] = dx;
  std::vector<NodeForce> force(6);
  force[0].z = fz;
  force[1].x = 1;
  return check.is_explained(u, force, {}, is_pressed);
}

bool is_explained_without_force(const SpreadCheck& check, const std::vector<int16_t>& u) {
  return check.is_explained(u, std::vector<NodeForce>(6), {}, false);
}

TEST(SpreadCheck, AMotionBeyondTheLimitNeedsAForce) {
  const File file;
  const auto check = file.load();
  ASSERT_TRUE(check.has_value());
  EXPECT_TRUE(is_explained(check.value(), 285, 0)) << "285 000 of 250 000 and an eighth of it";
  EXPECT_FALSE(is_explained(check.value(), 286, 0));
  EXPECT_TRUE(is_explained(check.value(), 360, 80'000)) << "3 each step: 240 000 of 360 000";
  EXPECT_FALSE(is_explained(check.value(), 360, -80'000)) << "the other way";
}

// It opens single nodes, whose forces would explain it.
TEST(SpreadCheck, ForcesOfAFrameInWhichNoNodePressesExplainNothing) {
  const File file;
  const auto check = file.load();
  ASSERT_TRUE(check.has_value());
  constexpr int32_t kWhole = 17'000;  // 51 000, as node 2
  EXPECT_TRUE(is_explained(check.value(), 51, kWhole, true));
  EXPECT_FALSE(is_explained(check.value(), 51, kWhole, false)) << "half the limit is 50 000";
  EXPECT_TRUE(is_explained(check.value(), 50, kWhole, false));
}

// A plate wider than the pad causes no force at any node.
TEST(SpreadCheck, WithoutAnyForceHalfTheLimitMayMoveOutwards) {
  const File file;
  const auto check = file.load();
  ASSERT_TRUE(check.has_value());
  std::vector<int16_t> u(18);
  u[kXOfNode2] = 50;
  EXPECT_TRUE(is_explained_without_force(check.value(), u));
  u[kXOfNode2] = 51;
  EXPECT_FALSE(is_explained_without_force(check.value(), u));
}

TEST(SpreadCheck, WithoutAnyForceNoiseRaisesTheLimit) {
  const File file;
  const auto check = file.load();
  ASSERT_TRUE(check.has_value());
  std::vector<int16_t> u(18);
  u[kXOfNode2] = 100;
  u[0] = 40;
  EXPECT_TRUE(is_explained_without_force(check.value(), u)) << "60 000 of 140 000 / 2";
  u[0] = 30;
  EXPECT_FALSE(is_explained_without_force(check.value(), u)) << "70 000 of 130 000 / 2";
}

TEST(SpreadCheck, WithoutAnyForceAShiftIsNoNoise) {
  const File file;
  const auto check = file.load();
  ASSERT_TRUE(check.has_value());
  std::vector<int16_t> u(18);
  for (size_t node = 0; node < 6; ++node) u[3 * node] = 100;
  u[kXOfNode2] += 114;
  EXPECT_TRUE(is_explained_without_force(check.value(), u)) << "114 000 of 100 000 and an eighth of it";
  ++u[kXOfNode2];
  EXPECT_FALSE(is_explained_without_force(check.value(), u));
}

TEST(SpreadCheck, WhatFiniteStrainAddedMovesNothing) {
  const File file;
  const auto check = file.load();
  ASSERT_TRUE(check.has_value());
  std::vector<int16_t> u(18);
  std::vector<NodeForce> force(6);
  force[3].x = 60'000;  // -300 000
  EXPECT_FALSE(check.value().is_explained(u, force, {}, true));
  EXPECT_TRUE(check.value().is_explained(u, force, force, true));
}

TEST(SpreadCheck, RefusesTablesThatCouldOverflowOrSayNothing) {
  EXPECT_FALSE(File(0).load().has_value());
  EXPECT_FALSE(File(100, SpreadCheck::kMaxSpread + 1).load().has_value());
}

TEST(SpreadCheck, AnEighthOfTheRimIsTheMostThatMayPress) {
  constexpr GridSize kGrid{5, 5};  // 16 nodes of rim
  std::vector<NodeForce> force(25);
  force[12].z = -9'000;  // the middle is none
  for (const size_t i : {0U, 20U}) force[i].z = -26;
  EXPECT_FALSE(is_rim_pressed(kGrid, force, 100));
  force[15].z = -26;
  EXPECT_TRUE(is_rim_pressed(kGrid, force, 100));
  EXPECT_FALSE(is_rim_pressed(kGrid, force, 104)) << "a quarter of it is 26";
}

}  // namespace
}  // namespace ruffini
