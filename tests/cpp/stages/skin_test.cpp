#include <gtest/gtest.h>

#include <cmath>

#include "stages/skin/skin_shape.h"
#include "stages/skin/skin_track.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

constexpr int64_t kOne = int64_t{1} << 30;

BoardSettings tube(int averaged_frames) {
  BoardSettings board = test::round_board();
  board.pad.size_x_um = 251'327;
  board.skin = {.shape = SkinShape::kTube, .radius_um = 40'000, .averaged_frames = averaged_frames};
  return board;
}

SkinTouchList touches(std::initializer_list<SkinTouch> each) {
  SkinTouchList list;
  for (const SkinTouch& touch : each) list.touch[static_cast<size_t>(list.n_listed++)] = touch;
  list.n_found = list.n_listed;
  return list;
}

SkinTouch at(int64_t x_um, int64_t y_um, int64_t press_un = 1'000'000) {
  return {.x_um = x_um, .y_um = y_um, .press_un = press_un};
}

TEST(SkinTrack, KeepsWhoIsWhoWhileTheyMoveAndChangeOrder) {
  SkinTrack track(tube(1));
  SkinTouchList list = touches({at(0, 0), at(30'000, 0)});
  track.run(list);
  const uint32_t left = list.touch[0].id;
  const uint32_t right = list.touch[1].id;
  EXPECT_NE(left, right);
  EXPECT_NE(left, 0U);
  for (int frame = 1; frame < 6; ++frame) {
    list = touches({at(30'000 - 2'000 * frame, 0), at(2'000 * frame, 1'000)});
    track.run(list);
    EXPECT_EQ(list.touch[0].id, right) << frame;
    EXPECT_EQ(list.touch[1].id, left) << frame;
  }
  list = touches({at(-60'000, 20'000)});
  track.run(list);
  EXPECT_NE(list.touch[0].id, left);
  EXPECT_NE(list.touch[0].id, right);
}

TEST(SkinTrack, GoesOnRoundTheTubeAndOverAFewFramesWithoutTouch) {
  SkinTrack track(tube(1));
  SkinTouchList list = touches({at(125'000, 0)});
  track.run(list);
  const uint32_t id = list.touch[0].id;
  for (int i = 0; i < SkinTrack::kMaxUnseenFrames; ++i) {
    SkinTouchList nothing;
    track.run(nothing);
  }
  list = touches({at(-125'000, 500)});
  track.run(list);
  EXPECT_EQ(list.touch[0].id, id);
  for (int i = 0; i <= SkinTrack::kMaxUnseenFrames; ++i) {
    SkinTouchList nothing;
    track.run(nothing);
  }
  list = touches({at(-125'000, 500)});
  track.run(list);
  EXPECT_NE(list.touch[0].id, id);
}

TEST(SkinTrack, MeanOverTheLastFramesOfTheSameTouch) {
  SkinTrack track(tube(3));
  const int64_t pressed[] = {9'000, 1'000, 2'000, 3'000};
  const int64_t mean[] = {9'000, 5'000, 4'000, 2'000};
  for (size_t i = 0; i < 4; ++i) {
    SkinTouchList list = touches({at(0, 0, pressed[i])});
    track.run(list);
    EXPECT_EQ(list.touch[0].press_un, mean[i]);
  }
  track.forget();
  SkinTouchList list = touches({at(0, 0, 7'000)});
  track.run(list);
  EXPECT_EQ(list.touch[0].press_un, 7'000);
}

TEST(SkinShape, OutIsOneLongAndPlacesAreOnTheSurface) {
  for (const SkinShape shape : {SkinShape::kPlane, SkinShape::kTube, SkinShape::kDome}) {
    const SkinSettings skin = {.shape = shape, .radius_um = shape == SkinShape::kPlane ? 0 : 40'000};
    for (const auto& [x, y] : {std::pair<int64_t, int64_t>{0, 0}, {12'345, -20'000}, {-40'000, 7'000}}) {
      const SkinPoint p = on_skin(skin, x, y);
      double length = 0;
      for (const int64_t c : p.out_q30) length += std::pow(static_cast<double>(c) / kOne, 2);
      EXPECT_NEAR(length, 1.0, 1e-4);
    }
  }
  const SkinSettings skin = {.shape = SkinShape::kTube, .radius_um = 40'000};
  const SkinPoint quarter = on_skin(skin, 62'832, 5'000);  // a quarter round
  EXPECT_NEAR(static_cast<double>(quarter.place_um[0]), 0, 2);
  EXPECT_NEAR(static_cast<double>(quarter.place_um[1]), 40'000, 2);
  EXPECT_EQ(quarter.place_um[2], 5'000);
  const auto force = pressing_vector_un(quarter, 2'000'000);
  EXPECT_NEAR(static_cast<double>(force[1]), -2'000'000, 10);
  const SkinPoint side = on_skin({.shape = SkinShape::kDome, .radius_um = 40'000}, 0, 62'832);  // the dome's rim
  EXPECT_NEAR(static_cast<double>(side.place_um[1]), 40'000, 3);
  EXPECT_NEAR(static_cast<double>(side.place_um[2]), -40'000, 3);
}

}  // namespace
}  // namespace ruffini
