#include "image/marker_hole.h"

#include <gtest/gtest.h>

#include <vector>

namespace ruffini {
namespace {

constexpr GridSize kSize = {7, 7};
constexpr int kPitchPx = 20;
constexpr int kWidth = 7 * kPitchPx;
constexpr int kHeight = 7 * kPitchPx;

// A lattice that fills the picture, every marker well seen and where it was at rest.
std::vector<Marker> lattice() {
  std::vector<Marker> out(49);
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

constexpr int64_t kMiddleUm = 1'000;

MarkerSettings settings(int64_t pitch_x_um, int64_t pitch_y_um) {
  MarkerSettings out;
  out.lattice = kSize;
  out.pitch_x_um = pitch_x_um;
  out.pitch_y_um = pitch_y_um;
  return out;
}

void lose(Marker& m) { m.is_lost = true; }

bool is_hole(const Places& lost, void (*spoil)(Marker&) = lose,
             const MarkerSettings& board = settings(kMiddleUm, kMiddleUm)) {
  std::vector<Marker> markers = lattice();
  for (const auto& [i, j] : lost) spoil(markers[static_cast<size_t>(j * kSize.n_x + i)]);
  return has_hole(markers, board, kWidth, kHeight);
}

bool is_wide_hole(const Places& lost, void (*spoil)(Marker&) = lose) {
  return is_hole(lost, spoil, settings(kWidePitchUm, kWidePitchUm));
}

TEST(MarkerHole, FourThatGoTogetherAreOne) {
  EXPECT_FALSE(is_hole({}));
  EXPECT_TRUE(is_hole({{2, 2}, {3, 2}, {2, 3}, {3, 3}}));
  EXPECT_TRUE(is_hole({{3, 1}, {2, 2}, {3, 2}, {4, 2}, {3, 3}})) << "a cross";
  EXPECT_TRUE(is_hole({{1, 1}, {3, 1}, {1, 3}, {3, 3}})) << "as far apart as they may be";
  EXPECT_TRUE(is_hole({{3, 1}, {1, 2}, {1, 3}, {2, 3}})) << "the first one at the right";
  EXPECT_TRUE(is_hole({{5, 5}, {4, 5}, {3, 5}, {5, 3}})) << "in the corner";
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
  MarkerSettings three = settings(kMiddleUm, kMiddleUm);
  three.lattice = {3, 3};
  EXPECT_FALSE(has_hole(std::span(few).first(9), three, kWidth, kHeight)) << "nothing inside the border";
}

TEST(MarkerHole, ANarrowLatticeNeedsTenOfFiveByFive) {
  const auto is_narrow_hole = [](const Places& lost) {
    return is_hole(lost, lose, settings(kNarrowPitchUm - 1, kMiddleUm));
  };
  Places ten;
  for (int j = 1; j < 3; ++j) {
    for (int i = 1; i < 6; ++i) ten.emplace_back(i, j);
  }
  EXPECT_TRUE(is_narrow_hole(ten));
  const Places nine(ten.begin(), ten.end() - 1);
  EXPECT_FALSE(is_narrow_hole(nine));
  EXPECT_TRUE(is_hole(nine, lose, settings(kNarrowPitchUm, kNarrowPitchUm)));
  Places to_the_corner = nine;
  to_the_corner.emplace_back(5, 5);
  EXPECT_TRUE(is_narrow_hole(to_the_corner)) << "the last column and row of 5 x 5";
  Places from_the_right = {{5, 1}};
  for (int j = 2; j < 5; ++j) {
    for (int i = 1; i < 4; ++i) from_the_right.emplace_back(i, j);
  }
  EXPECT_TRUE(is_narrow_hole(from_the_right)) << "the first one at the right";
}

TEST(MarkerHole, TwoLostNeighboursOfAWideLatticeAreOne) {
  EXPECT_TRUE(is_wide_hole({{2, 2}, {3, 2}})) << "beside each other";
  EXPECT_TRUE(is_wide_hole({{4, 3}, {4, 4}})) << "one below the other";
  EXPECT_TRUE(is_wide_hole({{1, 1}, {4, 4}, {5, 4}})) << "not the first ones";
  EXPECT_FALSE(is_wide_hole({{2, 2}, {3, 3}})) << "across";
  EXPECT_FALSE(is_wide_hole({{2, 2}, {4, 2}})) << "apart";
  EXPECT_FALSE(is_wide_hole({{5, 2}, {6, 2}})) << "one at the border";
  EXPECT_FALSE(is_wide_hole({{2, 5}, {2, 6}})) << "one at the border";
  EXPECT_FALSE(is_wide_hole({{2, 2}, {3, 2}}, [](Marker& m) { m.quality = 39; }))
      << "of low confidence, as under a press";
  EXPECT_FALSE(is_wide_hole({{2, 2}, {3, 2}}, [](Marker& m) { m.is_lost = m.is_absent = true; })) << "never seen";
  const auto lose_and = [](void (*spoil)(Marker&), size_t second) {
    std::vector<Marker> markers = lattice();
    lose(markers[static_cast<size_t>(2 * kSize.n_x + 2)]);
    spoil(markers[second]);
    return has_hole(markers, settings(kWidePitchUm, kWidePitchUm), kWidth, kHeight);
  };
  for (const size_t second : {size_t{2 * kSize.n_x + 3}, size_t{3 * kSize.n_x + 2}}) {
    EXPECT_TRUE(lose_and(lose, second));
    EXPECT_FALSE(lose_and([](Marker& m) { m.is_lost = m.is_absent = true; }, second)) << "the other never seen";
    const auto leave = [](Marker& m) {
      m.is_lost = true;
      m.displacement_x = ImagePx::from_raw(-(5 * kPitchPx) << 16);
    };
    EXPECT_FALSE(lose_and(leave, second)) << "the other left the view";
  }
  EXPECT_FALSE(is_hole({{2, 2}, {3, 2}}, lose, settings(kWidePitchUm, kWidePitchUm - 1)));
  EXPECT_FALSE(is_hole({{2, 2}, {3, 2}}, lose, settings(kWidePitchUm - 1, kWidePitchUm)));
}

}  // namespace
}  // namespace ruffini
