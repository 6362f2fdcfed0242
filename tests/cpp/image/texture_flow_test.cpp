#include "image/texture_flow.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "support/test_board.h"

namespace ruffini {
namespace {

constexpr int kWidth = 160;
constexpr int kHeight = 120;

BoardSettings textured_board() {
  BoardSettings board = test::round_board();
  board.markers.polarity = Polarity::kTexture;
  board.markers.threshold_1e3 = 700;
  board.stages = {"difference", "markers", "displacement"};
  return board;
}

// Smooth speckle that is known between the pixels: a sum of waves.
class Speckle {
 public:
  explicit Speckle(unsigned seed) : random_(seed) {
    for (Wave& w : waves_) {
      w = {uniform(-1.2, 1.2), uniform(-1.2, 1.2), uniform(0, 6.28), uniform(200, 600)};
    }
  }

  double at(double x, double y) const {
    double v = 6000;
    for (const Wave& w : waves_) v += w.height * std::sin(w.along_x * x + w.along_y * y + w.phase);
    return v;
  }

  // What was at (x, y) is at (x, y) + move(x, y); gain and noise in 1/16 levels of B + G + R.
  template <typename Back>
  std::vector<uint16_t> picture(Back back, double gain, double noise) {
    std::normal_distribution<double> normal(0, noise);
    std::vector<uint16_t> out;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const auto [from_x, from_y] = back(x, y);
        out.push_back(static_cast<uint16_t>(std::clamp(gain * at(from_x, from_y) + normal(random_), 0.0, 12'240.0)));
      }
    }
    return out;
  }

 private:
  struct Wave {
    double along_x, along_y, phase, height;
  };
  double uniform(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random_); }
  std::mt19937 random_;  // NOLINT: the same numbers on every run
  std::array<Wave, 24> waves_{};
};

std::pair<double, double> unmoved(double x, double y) { return {x, y}; }

TEST(TextureFlow, FindsShiftStretchAndChangedLight) {
  Speckle speckle(3);
  TextureFlow flow(textured_board());
  EXPECT_EQ(flow.learn(speckle.picture(unmoved, 1.0, 30)), 63);
  // Back: X = 80 + (x - 83.4) / 1.03, so a place X moves by 3.4 + 0.03 (X - 80).
  const auto moved =
      speckle.picture([](double x, double y) { return std::pair{80 + (x - 83.4) / 1.03, y + 5.7}; }, 0.85, 60);
  EXPECT_EQ(flow.track(moved), 0);
  for (const Marker& m : flow.markers()) {
    EXPECT_NEAR(m.displacement_x.raw() / 65536.0, 3.4 + 0.03 * (m.rest_x.raw() / 65536.0 - 80), 0.1);
    EXPECT_NEAR(m.displacement_y.raw() / 65536.0, -5.7, 0.1);
  }
}

TEST(TextureFlow, KnowsNoHistory) {
  Speckle speckle(4);
  const auto rest = speckle.picture(unmoved, 1.0, 0);
  const auto far = speckle.picture([](double x, double y) { return std::pair{x - 11.0, y + 9.0}; }, 1.0, 0);
  TextureFlow fresh(textured_board());
  TextureFlow old(textured_board());
  fresh.learn(rest);
  old.learn(rest);
  old.track(far);
  fresh.track(rest);
  old.track(rest);
  for (size_t i = 0; i < fresh.markers().size(); ++i) {
    EXPECT_EQ(fresh.markers()[i].displacement_x, old.markers()[i].displacement_x);
    EXPECT_EQ(fresh.markers()[i].displacement_x.raw(), 0);
  }
}

TEST(TextureFlow, AnotherTextureIsLostAndAFlatOneIsAbsent) {
  Speckle speckle(5);
  Speckle other(6);
  TextureFlow flow(textured_board());
  flow.learn(speckle.picture(unmoved, 1.0, 0));
  EXPECT_GT(flow.track(other.picture(unmoved, 1.0, 0)), 55);
  EXPECT_EQ(flow.track(std::vector<uint16_t>(kWidth * kHeight, 6000)), 63);
  EXPECT_EQ(flow.learn(std::vector<uint16_t>(kWidth * kHeight, 6000)), 0);
  EXPECT_TRUE(flow.markers()[0].is_absent);
}

TEST(TextureFlow, APatchThatIsHiddenIsFilledFromItsNeighbours) {
  Speckle speckle(7);
  TextureFlow flow(textured_board());
  flow.learn(speckle.picture(unmoved, 1.0, 0));
  auto moved = speckle.picture([](double x, double y) { return std::pair{x - 2.0, y}; }, 1.0, 0);
  const size_t middle = 3 * 9 + 4;
  const int center_x = (flow.markers()[middle].rest_x.raw() >> 16) + 2;
  const int center_y = flow.markers()[middle].rest_y.raw() >> 16;
  for (int y = center_y - 8; y < center_y + 8; ++y) {
    for (int x = center_x - 7; x < center_x + 7; ++x) moved[static_cast<size_t>(y * kWidth + x)] = 2000;
  }
  flow.track(moved);
  EXPECT_TRUE(flow.markers()[middle].is_lost);
  EXPECT_NEAR(flow.markers()[middle].displacement_x.raw() / 65536.0, 2.0, 0.3);
}

}  // namespace
}  // namespace ruffini
