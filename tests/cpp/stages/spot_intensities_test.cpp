#include "stages/spot_intensities/spot_intensities.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <vector>

#include "support/test_board.h"

namespace ruffini {
namespace {

// 9 x 7 spots of 6 px, 15 px apart, on 160 x 120 px; level 100 on black.
constexpr int kWidth = 160;
constexpr int kHeight = 120;
constexpr size_t kSpots = 63;
constexpr int kLevel = 100;

struct Scene {
  BoardSettings board = test::round_board();
  std::vector<uint8_t> pixels = std::vector<uint8_t>(size_t{3} * kWidth * kHeight);
  std::vector<int32_t> features = std::vector<int32_t>(kSpots, -1);

  // Square of 10 px about spot k, wider than its disc.
  void paint(size_t k, int level) {
    const int x0 = 20 + 15 * static_cast<int>(k % 9) - 5;
    const int y0 = 15 + 15 * static_cast<int>(k / 9) - 5;
    for (int y = y0; y < y0 + 10; ++y) {
      for (int x = x0; x < x0 + 10; ++x) {
        std::fill_n(pixels.begin() + 3 * (static_cast<ptrdiff_t>(y) * kWidth + x), 3, static_cast<uint8_t>(level));
      }
    }
  }
  void paint_all(int level) {
    for (size_t k = 0; k < kSpots; ++k) paint(k, level);
  }
  [[nodiscard]] std::vector<uint16_t> grey() const {
    std::vector<uint16_t> out(pixels.size() / 3);
    for (size_t i = 0; i < out.size(); ++i) out[i] = static_cast<uint16_t>(48 * pixels[3 * i]);
    return out;
  }
  void learn(SpotIntensities& spots) const {
    std::vector<uint16_t> rest(pixels.size());
    std::transform(pixels.begin(), pixels.end(), rest.begin(), [](uint8_t p) { return static_cast<uint16_t>(16 * p); });
    spots.learn(grey(), rest);
  }
  SpotIntensities::Outcome run(SpotIntensities& spots) {
    return spots.run(grey(),
                     {.data = pixels.data(), .width = kWidth, .height = kHeight, .channels = 3, .stride = 3 * kWidth},
                     features, is_wrong);
  }
  bool is_wrong = false;  // as an earlier stage says
};

TEST(SpotIntensities, IsTheShareOfLightAtRest) {
  Scene scene;
  SpotIntensities spots(scene.board);
  ASSERT_TRUE(spots.has_places());
  scene.paint_all(kLevel);
  scene.learn(spots);
  scene.run(spots);
  EXPECT_EQ(scene.features, std::vector<int32_t>(kSpots, 0));
  scene.paint(10, 150);
  scene.paint(30, 75);
  const SpotIntensities::Outcome seen = scene.run(spots);
  EXPECT_EQ(scene.features[10], SpotIntensities::kOne / 2);
  EXPECT_EQ(scene.features[30], -SpotIntensities::kOne / 4);
  EXPECT_EQ(scene.features[11], 0);
  EXPECT_EQ(seen.n_lost, 0);
  EXPECT_FALSE(seen.is_light_wrong);
}

TEST(SpotIntensities, FollowsLampsThatAgeWhileNothingPresses) {
  Scene scene;
  SpotIntensities spots(scene.board);
  scene.paint_all(kLevel);
  scene.learn(spots);
  scene.paint_all(102);
  for (int i = 0; i < 200; ++i) EXPECT_FALSE(scene.run(spots).is_light_wrong);
  for (const int32_t f : scene.features) EXPECT_LT(std::abs(f), SpotIntensities::kOne / 500);
  scene.paint_all(103);
  scene.paint(5, 106);  // one spot 3 % off the others stops it
  scene.run(spots);
  const std::vector<int32_t> pressed = scene.features;
  for (int i = 0; i < 200; ++i) scene.run(spots);
  EXPECT_EQ(scene.features, pressed);
}

// Lamps are followed to 25 %. Beyond that the light counts as changed.
TEST(SpotIntensities, FollowsLampsNoFurtherThanAQuarter) {
  Scene scene;
  SpotIntensities spots(scene.board);
  scene.paint_all(kLevel);
  scene.learn(spots);
  for (int level = kLevel; level <= 140; ++level) {
    scene.paint_all(level);
    for (int i = 0; i < 60; ++i) EXPECT_EQ(scene.run(spots).is_light_wrong, level >= 130) << level;
  }
  EXPECT_EQ(scene.features[0], (SpotIntensities::kOne * 14 * 4 / 10 + 2) / 5 - SpotIntensities::kOne);
}

TEST(SpotIntensities, FlagsLightThatChangesAtAStroke) {
  Scene scene;
  SpotIntensities spots(scene.board);
  scene.paint_all(kLevel);
  scene.learn(spots);
  scene.paint_all(106);
  EXPECT_TRUE(scene.run(spots).is_light_wrong);
  for (size_t k = 0; k < 31; ++k) scene.paint(k, 120 + 3 * static_cast<int>(k));
  EXPECT_TRUE(scene.run(spots).is_light_wrong) << "half of the spots agree, the others are pressed";
  for (size_t k = 31; k < 34; ++k) scene.paint(k, 120 + 3 * static_cast<int>(k));
  EXPECT_FALSE(scene.run(spots).is_light_wrong) << "a press on more than half of the spots may be all of it";
}

// A frame that is known to be wrong, or hides too many spots, teaches nothing.
TEST(SpotIntensities, FollowsNoLampsInAWrongFrame) {
  Scene scene;
  SpotIntensities spots(scene.board);
  scene.paint_all(kLevel);
  scene.learn(spots);
  scene.paint_all(102);
  scene.is_wrong = true;
  for (int i = 0; i < 60; ++i) scene.run(spots);
  EXPECT_EQ(scene.features[0], (SpotIntensities::kOne + 25) / 50);
  scene.is_wrong = false;
  for (size_t k = 0; k <= static_cast<size_t>(scene.board.markers.max_lost); ++k) scene.paint(k, 255);
  for (int i = 0; i < 60; ++i) scene.run(spots);
  EXPECT_EQ(scene.features[kSpots - 1], (SpotIntensities::kOne + 25) / 50);
}

TEST(SpotIntensities, FillsASaturatedOrDarkSpotFromItsNeighbours) {
  Scene scene;
  SpotIntensities spots(scene.board);
  scene.paint_all(kLevel);
  scene.paint(40, 10);
  scene.paint(12, 255);
  scene.learn(spots);
  scene.paint_all(120);
  scene.paint(20, 255);
  scene.paint(60, 0);
  scene.paint(40, 255);  // was dark at rest
  EXPECT_EQ(scene.run(spots).n_lost, 4);
  const auto fifth = static_cast<int32_t>((SpotIntensities::kOne * 6 + 2) / 5 - SpotIntensities::kOne);
  for (const int32_t f : scene.features) EXPECT_EQ(f, fifth);
}

TEST(SpotIntensities, OfNothingAreZeroAndLost) {
  Scene scene;
  SpotIntensities spots(scene.board);
  scene.learn(spots);
  EXPECT_EQ(scene.run(spots).n_lost, static_cast<int>(kSpots));
  EXPECT_EQ(scene.features, std::vector<int32_t>(kSpots, 0));
}

TEST(SpotIntensities, ScatteredSpotsNeedPlaces) {
  Scene scene;
  scene.board.markers.is_scattered = true;
  EXPECT_FALSE(SpotIntensities(scene.board).has_places());
  scene.board.markers.places = {{.x_um = 2'000, .y_um = 1'500}};
  EXPECT_TRUE(SpotIntensities(scene.board).has_places());
}

}  // namespace
}  // namespace ruffini
