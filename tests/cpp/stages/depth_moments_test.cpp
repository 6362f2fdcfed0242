#include "stages/depth_moments/depth_moments.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <vector>

#include "support/test_board.h"

namespace ruffini {
namespace {

// 160 x 120 cells of 100 um, the window is the whole pad.
constexpr int kX = 160;
constexpr int kCells = 160 * 120;
constexpr int kUm = 1 << 14;  // of all features but the area

using Features = std::array<int32_t, DepthMoments::kCount>;
using Map = std::vector<DisplacementUm>;

Map flat(int um) { return Map(kCells, DisplacementUm::from_raw(static_cast<int16_t>(8 * um))); }

// Rectangle from cell (x, y) on.
Map dent(int x, int y, int n_x, int n_y, int um) {
  Map out = flat(0);
  for (int j = y; j < y + n_y; ++j) {
    for (int i = x; i < x + n_x; ++i) {
      out[static_cast<size_t>(j * kX + i)] = DisplacementUm::from_raw(static_cast<int16_t>(-8 * um));
    }
  }
  return out;
}

Features features(const Map& map, const BoardSettings& board = test::round_board()) {
  Features out;
  out.fill(-1);
  DepthMoments(board).run(map, out);
  return out;
}

TEST(DepthMoments, AreZeroWhereNothingIsDeeperThanNoise) {
  EXPECT_EQ(features(flat(0)), Features{});
  EXPECT_EQ(features(flat(-10)), Features{}) << "10 um are not counted";
  EXPECT_EQ(features(flat(500)), Features{}) << "a bulge";
}

TEST(DepthMoments, OfARectangleAreItsSums) {
  // 40 x 30 cells from x = 0.25 on and from y = -0.5 on of half the pad, 1/16 of the window, 200 um beyond the first 10
  const Features f = features(dent(100, 30, 40, 30, 210));
  constexpr double kVolume = 200.0 / 16 * kUm;
  EXPECT_EQ(f[0], 200 * kUm / 16);
  EXPECT_EQ(f[1], 1 << 20);
  EXPECT_EQ(f[2], 200 * kUm);
  EXPECT_NEAR(f[3], 0.5 * kVolume, 1e-3 * kVolume);
  EXPECT_NEAR(f[4], -0.25 * kVolume, 1e-3 * kVolume);
  EXPECT_NEAR(f[5], (0.25 + 0.25 / 12) * kVolume, 1e-3 * kVolume);
  EXPECT_NEAR(f[6], (0.0625 + 0.25 / 12) * kVolume, 1e-3 * kVolume);
  EXPECT_NEAR(f[7], -0.125 * kVolume, 1e-3 * kVolume);
}

TEST(DepthMoments, BeginAtTheFirstTouchedCellWithoutAJump) {
  Map map = flat(0);
  map[60 * kX + 150] = DisplacementUm::from_raw(-DepthMoments::kLeast - 1);
  for (const int32_t f : features(map)) EXPECT_LE(std::abs(f), 1 << 11) << "1/8 um";
}

TEST(DepthMoments, OfTheDeepestMapFitTheWrench) {
  const Features f = features(Map(kCells, DisplacementUm::from_raw(-32'768)));
  for (const int32_t each : f) EXPECT_LE(std::abs(each), 1 << 26);  // FeatureWrench::kMaxFeature
  EXPECT_EQ(f[0], (32'768 - DepthMoments::kLeast) << 11);
  EXPECT_EQ(f[1], 1 << 24);
  EXPECT_NEAR(f[5], f[0] / 3, f[0] / 1'000);
}

TEST(DepthMoments, SeeTheWindowAlone) {
  BoardSettings board = test::round_board();
  board.window = {.min_x_um = 8'000, .min_y_um = 0, .max_x_um = 16'000, .max_y_um = 6'000};
  EXPECT_EQ(features(dent(0, 0, 80, 120, 400), board), Features{});
  EXPECT_EQ(features(dent(80, 0, 80, 60, 410), board)[0], 400 * kUm) << "the mean over the window";
}

TEST(DepthMoments, OfAWindowWithoutACellAreZero) {
  BoardSettings board = test::round_board();
  board.window = {.min_x_um = 10, .min_y_um = 10, .max_x_um = 20, .max_y_um = 20};
  EXPECT_EQ(features(flat(-500), board), Features{});
}

}  // namespace
}  // namespace ruffini
