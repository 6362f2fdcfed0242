#include "image/targets.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace ruffini {
namespace {

constexpr int kWidth = 320;
constexpr int kHeight = 240;
constexpr double kGrey = 48.0;  // of a level in three channels (image/difference.h)

// Two targets of 20 px radius, 80 px either side of the middle: 10 mm from a pinhole of f = 200 px.
BoardSettings two_targets() {
  BoardSettings board;
  board.camera.width_px = kWidth;
  board.camera.height_px = kHeight;
  board.camera.focal_mpx = 200'000;
  board.camera.center_x_mpx = 159'500;
  board.camera.center_y_mpx = 119'500;
  board.camera.standoff_um = 12'000;
  board.pad.size_x_um = 14'000;
  board.pad.size_y_um = 10'000;
  board.targets = {.places = {{3'000, 5'000}, {11'000, 5'000}},  // (79.5, 119.5) and (239.5, 119.5) px
                   .below_um = 2'000,
                   .diameter_um = 2'000,
                   .threshold_1e3 = 400};
  return board;
}

struct Disc {
  double x;
  double y;
  double radius;
};

// Dark discs with an edge of one pixel, on light that grows to the right by `slant`.
std::vector<uint16_t> drawn(const std::vector<Disc>& discs, double slant = 0.0) {
  std::vector<uint16_t> grey(size_t{kWidth} * kHeight);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      double level = 80.0 * (1.0 + slant * x / kWidth);
      for (const Disc& d : discs) {
        level += (12.0 - level) * std::clamp(d.radius + 0.5 - std::hypot(x - d.x, y - d.y), 0.0, 1.0);
      }
      grey[static_cast<size_t>(y * kWidth + x)] = static_cast<uint16_t>(kGrey * level);
    }
  }
  return grey;
}

double px(int64_t q16) { return static_cast<double>(q16) / 65'536; }

TEST(Targets, PlaceAndAreaOfADiscOnSlantedLight) {
  TargetTracker tracker(two_targets());
  ASSERT_EQ(tracker.learn(drawn({{79.5, 119.5, 20}, {239.5, 119.5, 20}}, 1.0)), 2);
  for (const double shift : {0.0, 0.13, 0.5, 3.77, 9.2}) {
    ASSERT_EQ(tracker.track(drawn({{79.5 + shift, 119.5 - shift, 20.6}, {239.5 + shift, 119.5, 20}}, 1.0)), 0);
    const Target& first = tracker.targets()[0];
    EXPECT_NEAR(px(first.now.x_q16 - first.rest.x_q16), shift, 0.01) << shift;
    EXPECT_NEAR(px(first.now.y_q16 - first.rest.y_q16), -shift, 0.01) << shift;
    EXPECT_NEAR(px(first.now.x_q16), 79.5 + shift, 0.05) << "slanted light pulls a little, at rest as well";
    const double growth = static_cast<double>(first.now.area_q8) / static_cast<double>(first.rest.area_q8);
    EXPECT_NEAR(growth, 20.6 * 20.6 / 400, 0.002) << shift;
  }
}

TEST(Targets, ADarkSpotBesideATargetMovesNoEdge) {
  TargetTracker tracker(two_targets());
  ASSERT_EQ(tracker.learn(drawn({{79.5, 119.5, 20}, {239.5, 119.5, 20}})), 2);
  ASSERT_EQ(tracker.track(drawn({{79.5, 119.5, 20}, {239.5, 119.5, 20}, {79.5, 160, 10}})), 0);
  EXPECT_NEAR(px(tracker.targets()[0].now.x_q16), 79.5, 0.01);
  EXPECT_NEAR(px(tracker.targets()[0].now.y_q16), 119.5, 0.05);
}

TEST(Targets, ATargetKeepsItsNumberAndOneThatIsGoneIsLost) {
  TargetTracker tracker(two_targets());
  ASSERT_EQ(tracker.learn(drawn({{79.5, 119.5, 20}, {239.5, 119.5, 20}})), 2);
  EXPECT_EQ(tracker.track(drawn({{250, 110, 20}})), 1);
  EXPECT_TRUE(tracker.targets()[0].is_lost);
  EXPECT_NEAR(px(tracker.targets()[1].now.x_q16), 250, 0.01);
  EXPECT_EQ(tracker.track(drawn({{79.5, 119.5, 20}, {262, 119.5, 20}})), 1) << "further off than its radius";
  EXPECT_EQ(tracker.track(drawn({{79.5, 119.5, 20}, {239.5, 119.5, 20}})), 0) << "and back";
}

TEST(Targets, OneThatIsHalfCoveredIsLost) {
  TargetTracker tracker(two_targets());
  ASSERT_EQ(tracker.learn(drawn({{79.5, 119.5, 20}, {239.5, 119.5, 20}})), 2);
  std::vector<uint16_t> grey = drawn({{79.5, 119.5, 20}, {239.5, 119.5, 20}});
  for (int y = 0; y < 119; ++y) std::fill_n(&grey[static_cast<size_t>(y * kWidth)], 160, uint16_t{80 * 48});
  EXPECT_EQ(tracker.track(grey), 1);
  EXPECT_TRUE(tracker.targets()[0].is_lost);
}

TEST(Targets, LightThatIsNotAsAtRest) {
  TargetTracker tracker(two_targets());
  const std::vector<uint16_t> rest = drawn({{79.5, 119.5, 20}, {239.5, 119.5, 20}});
  ASSERT_EQ(tracker.learn(rest), 2);
  tracker.track(rest);
  EXPECT_FALSE(tracker.is_light_wrong());
  std::vector<uint16_t> brighter = rest;
  for (uint16_t& each : brighter) each = static_cast<uint16_t>(each * 13 / 10);
  tracker.track(brighter);
  EXPECT_TRUE(tracker.is_light_wrong());
  EXPECT_NEAR(px(tracker.targets()[0].now.x_q16), 79.5, 0.01) << "the edge is where it was";
}

TEST(Targets, ABoardWithoutThemHasNone) {
  BoardSettings board = two_targets();
  board.targets = {};
  TargetTracker tracker(board);
  EXPECT_EQ(tracker.learn(drawn({{79.5, 119.5, 20}})), 0);
  EXPECT_EQ(tracker.track(drawn({{79.5, 119.5, 20}})), 0);
  EXPECT_FALSE(tracker.is_light_wrong());
}

}  // namespace
}  // namespace ruffini
