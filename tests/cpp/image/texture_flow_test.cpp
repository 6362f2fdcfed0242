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

// A frame, and what a rest image of it is.
struct Picture {
  std::vector<uint8_t> pixels;
  std::vector<uint16_t> levels;  // 1/16
  std::vector<uint16_t> grey;

  void put(double b, double g, double r) {
    uint16_t sum = 0;
    for (const double level : {b, g, r}) {
      pixels.push_back(static_cast<uint8_t>(std::clamp(std::round(level), 0.0, 255.0)));
      levels.push_back(static_cast<uint16_t>(16 * pixels.back()));
      sum = static_cast<uint16_t>(sum + pixels.back());
    }
    grey.push_back(static_cast<uint16_t>(12 * (sum + pixels[pixels.size() - 2])));
  }
  void hide(int x, int y) {
    const auto i = static_cast<size_t>(y * kWidth + x);
    std::fill_n(pixels.begin() + static_cast<ptrdiff_t>(3 * i), 3, uint8_t{42});
    grey[i] = 12 * 4 * 42;
  }
  [[nodiscard]] FrameView frame() const { return {pixels.data(), kWidth, kHeight, 3, ptrdiff_t{3} * kWidth}; }
};

int learn(TextureFlow& flow, const Picture& rest) { return flow.learn(rest.grey, rest.levels); }
int track(TextureFlow& flow, const Picture& now) { return flow.track(now.grey, now.frame()); }

Picture plain(double level) {
  Picture out;
  for (int i = 0; i < kWidth * kHeight; ++i) out.put(level, level, level);
  return out;
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

  // What was at (x, y) is at (x, y) + move(x, y); noise in 1/16 levels of B + G + R. All colours alike.
  template <typename Back>
  Picture picture(Back back, double gain, double noise) {
    std::normal_distribution<double> normal(0, noise);
    Picture out;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const auto [from_x, from_y] = back(x, y);
        const double level = (gain * at(from_x, from_y) + normal(random_)) / 48;
        out.put(level, level, level);
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
  EXPECT_EQ(learn(flow, speckle.picture(unmoved, 1.0, 30)), 63);
  // Back: X = 80 + (x - 83.4) / 1.03, so a place X moves by 3.4 + 0.03 (X - 80).
  const auto moved =
      speckle.picture([](double x, double y) { return std::pair{80 + (x - 83.4) / 1.03, y + 5.7}; }, 0.85, 60);
  EXPECT_EQ(track(flow, moved), 0);
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
  learn(fresh, rest);
  learn(old, rest);
  track(old, far);
  track(fresh, rest);
  track(old, rest);
  for (size_t i = 0; i < fresh.markers().size(); ++i) {
    EXPECT_EQ(fresh.markers()[i].displacement_x, old.markers()[i].displacement_x);
    EXPECT_EQ(fresh.markers()[i].displacement_x.raw(), 0);
  }
}

TEST(TextureFlow, AnotherTextureIsLostAndAFlatOneIsAbsent) {
  Speckle speckle(5);
  Speckle other(6);
  TextureFlow flow(textured_board());
  learn(flow, speckle.picture(unmoved, 1.0, 0));
  EXPECT_GT(track(flow, other.picture(unmoved, 1.0, 0)), 55);
  EXPECT_EQ(track(flow, plain(125)), 63);
  EXPECT_EQ(learn(flow, plain(125)), 0);
  EXPECT_TRUE(flow.markers()[0].is_absent);
}

TEST(TextureFlow, APatchThatIsHiddenIsFilledFromItsNeighbours) {
  Speckle speckle(7);
  TextureFlow flow(textured_board());
  learn(flow, speckle.picture(unmoved, 1.0, 0));
  auto moved = speckle.picture([](double x, double y) { return std::pair{x - 2.0, y}; }, 1.0, 0);
  const size_t middle = 3 * 9 + 4;
  const int center_x = (flow.markers()[middle].rest_x.raw() >> 16) + 2;
  const int center_y = flow.markers()[middle].rest_y.raw() >> 16;
  for (int y = center_y - 8; y < center_y + 8; ++y) {
    for (int x = center_x - 7; x < center_x + 7; ++x) moved.hide(x, y);
  }
  track(flow, moved);
  EXPECT_TRUE(flow.markers()[middle].is_lost);
  EXPECT_NEAR(flow.markers()[middle].displacement_x.raw() / 65536.0, 2.0, 0.3);
}

// Flakes of three colours that flash one by one, as the surface under them tilts: round spots with soft edges.
Picture glitter(unsigned seed, double shift_px, double flash) {
  std::mt19937 where(seed);  // NOLINT: the same flakes on every run
  std::mt19937 flashes(seed + 1);
  std::uniform_real_distribution<double> any(0, 1);
  std::array<std::vector<double>, 3> level;
  for (auto& plane : level) plane.assign(static_cast<size_t>(kWidth) * kHeight, 60.0);
  for (int flake = 0; flake < 900; ++flake) {
    const double x = any(where) * kWidth + shift_px;
    const double y = any(where) * kHeight;
    const auto colour = static_cast<size_t>(flake % 3);
    const double height = 120 * (1 + flash * (any(flashes) - 0.5));
    for (int v = std::max(0, static_cast<int>(y) - 5); v < std::min(kHeight, static_cast<int>(y) + 6); ++v) {
      for (int u = std::max(0, static_cast<int>(x) - 5); u < std::min(kWidth, static_cast<int>(x) + 6); ++u) {
        const double away = ((u - x) * (u - x) + (v - y) * (v - y)) / (2 * 1.3 * 1.3);
        level[colour][static_cast<size_t>(v * kWidth + u)] += height * std::exp(-away);
      }
    }
  }
  Picture out;
  for (size_t i = 0; i < level[0].size(); ++i) out.put(level[0][i], level[1][i], level[2][i]);
  return out;
}

double error_px(const TextureFlow& flow, double shift_px) {
  double sum = 0;
  int n = 0;
  for (const Marker& m : flow.markers()) {
    if (m.is_lost) continue;
    sum += std::pow(m.displacement_x.raw() / 65536.0 - shift_px, 2) + std::pow(m.displacement_y.raw() / 65536.0, 2);
    ++n;
  }
  return std::sqrt(sum / n);
}

TEST(TextureFlow, FlakesThatFlashAreSeenByTheirColours) {
  const double shift_px = 1.3;
  const Picture rest = glitter(8, 0, 0);
  const Picture now = glitter(8, shift_px, 0.8);
  TextureFlow flow(textured_board());
  learn(flow, rest);
  track(flow, now);
  // The same without colours: each pixel its own mean.
  const auto grey_only = [](const Picture& from) {
    Picture out;
    for (const uint16_t grey : from.grey) out.put(grey / 48.0, grey / 48.0, grey / 48.0);
    return out;
  };
  TextureFlow blind(textured_board());
  learn(blind, grey_only(rest));
  track(blind, grey_only(now));
  EXPECT_LT(error_px(flow, shift_px), 0.08);
  EXPECT_LT(error_px(flow, shift_px), 0.7 * error_px(blind, shift_px));
}

// Grey takes the mean shift of its samples for that of their centre; the colours speak for the patch's own place.
TEST(TextureFlow, AStretchIsOfThePatchesOwnPlaces) {
  Speckle speckle(9);
  TextureFlow flow(textured_board());
  learn(flow, speckle.picture(unmoved, 1.0, 0));
  track(flow, speckle.picture([](double x, double y) { return std::pair{80 + (x - 80) / 1.08, y}; }, 1.0, 0));
  for (const Marker& m : flow.markers()) {
    if (m.is_lost) continue;
    EXPECT_NEAR(m.displacement_x.raw() / 65536.0, 0.08 * (m.rest_x.raw() / 65536.0 - 80), 0.06);
  }
}

}  // namespace
}  // namespace ruffini
