#include "image/marker_hole.h"

#include <gtest/gtest.h>

#include <vector>

namespace ruffini {
namespace {

constexpr GridSize kSize = {7, 6};
constexpr int kPitchPx = 20;
constexpr int kWidth = 7 * kPitchPx;
constexpr int kHeight = 6 * kPitchPx;

// A lattice that fills the picture, every marker well seen and where it was at rest.
std::vector<Marker> lattice() {
  std::vector<Marker> out(42);
  for (int j = 0; j < kSize.n_y; ++j) {
    for (int i = 0; i < kSize.n_x; ++i) {
      Marker& m = out[static_cast<size_t>(j * kSize.n_x + i)];
      m.rest_x = ImagePx::from_raw((kPitchPx * i + kPitchPx / 2) << 16);
      m.rest_y = ImagePx::from_raw((kPitchPx * j + kPitchPx / 2) << 16);
      m.is_lost = m.is_absent = false;
      m.quality = 200;
    }
  }
  return out;
}

using Places = std::vector<std::pair<int, int>>;

bool is_hole(const Places& lost, void (*spoil)(Marker&) = [](Marker& m) { m.is_lost = true; }) {
  std::vector<Marker> markers = lattice();
  for (const auto& [i, j] : lost) spoil(markers[static_cast<size_t>(j * kSize.n_x + i)]);
  return has_hole(markers, kSize, kWidth, kHeight);
}

TEST(MarkerHole, FourThatGoTogetherAreOne) {
  EXPECT_FALSE(is_hole({}));
  EXPECT_TRUE(is_hole({{2, 2}, {3, 2}, {2, 3}, {3, 3}}));
  EXPECT_TRUE(is_hole({{3, 1}, {2, 2}, {3, 2}, {4, 2}, {3, 3}})) << "a cross";
  EXPECT_TRUE(is_hole({{1, 1}, {3, 1}, {1, 3}, {3, 3}})) << "as far apart as they may be";
  EXPECT_TRUE(is_hole({{3, 1}, {1, 2}, {1, 3}, {2, 3}})) << "the first one at the right";
  EXPECT_TRUE(is_hole({{5, 4}, {4, 4}, {3, 4}, {5, 2}})) << "in the corner";
  EXPECT_FALSE(is_hole({{2, 2}, {3, 2}, {2, 3}})) << "three";
  EXPECT_FALSE(is_hole({{1, 1}, {4, 1}, {1, 4}, {4, 4}})) << "apart";
}

TEST(MarkerHole, DoubtfulOnesCountAndThoseThatWereNeverSeenDoNot) {
  const Places four = {{2, 2}, {3, 2}, {2, 3}, {3, 3}};
  EXPECT_TRUE(is_hole(four, [](Marker& m) { m.quality = 39; }));
  EXPECT_FALSE(is_hole(four, [](Marker& m) { m.quality = 40; }));
  EXPECT_FALSE(is_hole(four, [](Marker& m) { m.is_lost = m.is_absent = true; }));
}

TEST(MarkerHole, WhatLeavesTheViewOrIsAtTheBorderIsNone) {
  EXPECT_FALSE(is_hole({{0, 0}, {1, 0}, {0, 1}, {0, 2}, {2, 0}}));
  const Places at_right = {{4, 2}, {5, 2}, {4, 3}, {5, 3}};
  EXPECT_TRUE(is_hole(at_right));
  EXPECT_FALSE(is_hole(at_right, [](Marker& m) {
    m.is_lost = true;
    m.displacement_x = ImagePx::from_raw((kPitchPx + 1) << 16);  // the fifth column is then half a pitch from the edge
  })) << "they left";
  std::vector<Marker> few = lattice();
  for (Marker& m : few) m.is_lost = true;
  EXPECT_FALSE(has_hole(std::span(few).first(9), {3, 3}, kWidth, kHeight)) << "nothing inside the border";
}

}  // namespace
}  // namespace ruffini
