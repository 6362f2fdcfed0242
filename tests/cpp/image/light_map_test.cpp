#include "image/light_map.h"

#include <gtest/gtest.h>

#include <cmath>

namespace ruffini {
namespace {

constexpr int kWidth = 320;
constexpr int kHeight = 240;

// Samples as image/light.h takes them, of a change that the map in force is taken off.
struct Picture {
  Picture() {
    for (int y = 4; y + 1 < kHeight; y += 8) {
      for (int x = 4; x + 8 <= kWidth; x += 16) at.push_back(y * kWidth + x);
    }
    map.learn(at);
  }
  [[nodiscard]] double factor_at(size_t channel, int x, int y) const {  // of the node nearest
    const GridSize nodes = Rest::map_nodes(kWidth, kHeight);
    const int i = (y + 8) / 16 * nodes.n_x + (x + 8) / 16;
    return map.factor()[channel * static_cast<size_t>(nodes.count()) + static_cast<size_t>(i)] /
           double{Rest::kUnitGain};
  }
  // So many windows of a change (x, y in -1..1) that has no mean.
  template <typename Change>
  void show(int n_windows, Change change, PadState pad = PadState::kAtRest) {
    for (int i = 0; i < n_windows * LightMap::kWindowFrames; ++i) {
      LightMap::Samples samples;
      for (const int32_t first : at) {
        const int x = first % kWidth + 4;
        const int y = first / kWidth + 1;
        for (size_t c = 0; c < 3; ++c) {
          const double rest = change(2.0 * x / kWidth - 1, 2.0 * y / kHeight - 1) - (factor_at(c, x, y) - 1);
          samples[c].push_back(static_cast<int16_t>(std::lround(4096 * rest)));
        }
      }
      (void)map.run(samples, pad, true, gain);
    }
  }

  std::vector<int32_t> at;
  LightMap map{kWidth, kHeight};
  Rest::Gain gain = Rest::unit_gain();
};

double bent(double u, double v) { return 0.003 * (u * v + u * u * u - v); }

TEST(LightMap, FollowsASmoothDriftOverThePicture) {
  Picture picture;
  picture.show(200, bent);
  EXPECT_NEAR(picture.factor_at(0, 16, 16), 1 + bent(-0.9, -0.867), 0.0006);
  EXPECT_NEAR(picture.factor_at(2, 288, 128), 1 + bent(0.8, 0.067), 0.0006);
  EXPECT_FALSE(picture.map.is_wrong());
}

TEST(LightMap, NeverLearnsWhatHasEdges) {
  Picture picture;
  picture.show(500, [](double u, double v) { return std::abs(u) < 0.3 && std::abs(v) < 0.4 ? -0.05 : 0; });
  for (const int32_t factor : picture.map.factor()) EXPECT_EQ(factor, Rest::kUnitGain);
}

TEST(LightMap, LearnsNothingWhileAMarkerIsOffItsRest) {
  Picture picture;
  picture.show(100, bent, PadState::kTouched);
  for (const int32_t factor : picture.map.factor()) EXPECT_EQ(factor, Rest::kUnitGain);
}

TEST(LightMap, ASmallSpotIsNotTakenForLight) {
  Picture picture;
  picture.show(500, [](double u, double v) { return u * u + v * v < 0.02 ? -0.1 : 0; });
  for (const int32_t factor : picture.map.factor()) EXPECT_NEAR(factor, Rest::kUnitGain, Rest::kUnitGain / 4'000);
}

TEST(LightMap, IsOffUntilAJumpIsFollowed) {
  Picture picture;
  const auto tilted = [](double u, double) { return 0.008 * u; };
  picture.show(1, tilted);
  EXPECT_TRUE(picture.map.is_wrong());
  picture.show(60, tilted);
  EXPECT_FALSE(picture.map.is_wrong());
}

// A touch too faint to move a marker by 1/4 px: a dent of 2 % over an eighth of the picture.
TEST(LightMap, AFaintTouchIsNeitherLearnedNorTakenForLight) {
  Picture picture;
  picture.show(200, [](double u, double v) { return u * u + v * v < 0.16 ? 0.05 * u : 0; });
  for (const int32_t factor : picture.map.factor()) EXPECT_EQ(factor, Rest::kUnitGain);
  EXPECT_FALSE(picture.map.is_wrong());
}

TEST(LightMap, APartOfALampThatFailsIsNotFollowedAndSaid) {
  const auto failed = [](double u, double v) { return -0.1 * std::exp(-4 * (u * u + v * v)); };
  Picture picture;
  picture.show(1, failed);
  EXPECT_TRUE(picture.map.is_wrong());
  picture.show(200, failed);
  EXPECT_TRUE(picture.map.is_wrong());
  for (const int32_t factor : picture.map.factor()) EXPECT_EQ(factor, Rest::kUnitGain);
  picture.show(1, [](double, double) { return 0.0; });
  EXPECT_FALSE(picture.map.is_wrong());
  // Without markers it could be a contact.
  Picture unmarked;
  unmarked.show(1, failed, PadState::kUnknown);
  EXPECT_FALSE(unmarked.map.is_wrong());
}

TEST(LightMap, WithoutMarkersAPressDoesNotEndTheFlagOfChangedLight) {
  const auto tilted = [](double u, double) { return 0.02 * u; };
  const auto pressed = [&](double u, double v) { return tilted(u, v) - (u * u + v * v < 0.3 ? 0.1 : 0.0); };
  Picture picture;
  picture.show(1, tilted, PadState::kUnknown);
  picture.show(5, pressed, PadState::kUnknown);
  EXPECT_TRUE(picture.map.is_wrong());
  picture.show(1, [](double, double) { return 0.0; }, PadState::kUnknown);
  EXPECT_FALSE(picture.map.is_wrong());
}

TEST(LightMap, WithoutMarkersALargeSmoothObjectIsNotLearned) {
  Picture picture;
  const auto tilted = [](double u, double) { return 0.02 * u; };
  picture.show(300, tilted, PadState::kUnknown);
  for (const int32_t factor : picture.map.factor()) EXPECT_EQ(factor, Rest::kUnitGain);
  EXPECT_TRUE(picture.map.is_wrong()) << "lamps or a contact";
  picture.show(1, [](double, double) { return 0.0; }, PadState::kUnknown);
  EXPECT_FALSE(picture.map.is_wrong());
  for (int i = 0; i < 100; ++i) picture.show(1, [&](double u, double) { return 0.0001 * i * u; }, PadState::kUnknown);
  EXPECT_NEAR(picture.factor_at(0, 304, 128), 1.009, 0.001) << "lamps are slow";
}

TEST(LightMap, GoesOnDuringAContactAsBeforeAndSaysSoWhereThatIsFar) {
  Picture picture;
  for (int i = 0; i < 300; ++i) picture.show(1, [&](double u, double) { return 0.0001 * i * u; });
  const double before = picture.factor_at(0, 304, 128);
  EXPECT_NEAR(before, 1.027, 0.003);
  picture.show(30, bent, PadState::kTouched);
  EXPECT_NEAR(picture.factor_at(0, 304, 128) - before, 30 * 0.00009, 0.0006);
  EXPECT_FALSE(picture.map.is_wrong());
  picture.show(200, bent, PadState::kTouched);
  EXPECT_TRUE(picture.map.is_wrong()) << "more than 1 % on trust";
}

}  // namespace
}  // namespace ruffini
