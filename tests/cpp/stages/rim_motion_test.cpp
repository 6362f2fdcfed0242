#include "stages/fingertip/rim_motion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace ruffini {
namespace {

constexpr int64_t kMaxUn = 1'300'000;

struct Way {
  double x_px = 0;
  double turn = 0;
  double zoom = 0;
  double dent_px = 0;  // outwards, of the pins within 40 px of one at (60, 0)
};

// Pins on rings about (160, 120).
std::vector<Marker> moved(const Way& way) {
  const auto raw = [](double px) { return ImagePx::from_raw(static_cast<int32_t>(std::lround(65'536 * px))); };
  std::vector<Marker> out;
  for (int ring = 1; ring <= 10; ++ring) {
    for (int i = 0; i < 5 * ring; ++i) {
      const double angle = 2 * 3.14159265358979 * i / (5 * ring);
      const double x = 10 * ring * std::cos(angle);
      const double y = 10 * ring * std::sin(angle);
      const bool is_pressed = std::hypot(x - 60, y) < 40;
      Marker m;
      m.rest_x = raw(160 + x);
      m.rest_y = raw(120 + y);
      m.displacement_x = raw(way.x_px + way.zoom * x - way.turn * y + (is_pressed ? way.dent_px : 0));
      m.displacement_y = raw(way.zoom * y + way.turn * x);
      m.is_lost = m.is_absent = false;
      out.push_back(m);
    }
  }
  return out;
}

class RimMotionTest : public testing::Test {
 protected:
  RimMotionTest() { rim_.learn(moved({})); }
  [[nodiscard]] bool has_moved(const Way& way, int64_t force_un = 0) const {
    return rim_.has_moved(moved(way), force_un, kMaxUn);
  }

  RimMotion rim_;
};

TEST_F(RimMotionTest, TellsWhatTheSectorsHaveInCommon) {
  const auto px = [](int64_t q16) { return static_cast<double>(q16) / 65'536; };
  EXPECT_NEAR(px(rim_.motion(moved({.x_px = 0.3})).shift_x_q16), 0.3, 1e-3);
  EXPECT_NEAR(px(rim_.motion(moved({.zoom = -0.01})).zoom_q16), 0.86, 0.06);
  EXPECT_NEAR(px(rim_.motion(moved({.turn = 0.01})).turn_q16), 0.86, 0.06);
  EXPECT_EQ(rim_.motion(moved({.zoom = 0.01})).shift_x_q16, 0);
}

TEST_F(RimMotionTest, ALittleIsEnoughWhereNothingPresses) {
  EXPECT_FALSE(has_moved({.x_px = 0.11}));
  EXPECT_TRUE(has_moved({.x_px = 0.13}));
  EXPECT_TRUE(has_moved({.zoom = 0.002}));
  EXPECT_TRUE(has_moved({.turn = -0.002}));
}

TEST_F(RimMotionTest, ALoadMovesTheRim) {
  EXPECT_FALSE(has_moved({.x_px = 0.5}, kMaxUn / 2));
  EXPECT_TRUE(has_moved({.x_px = 0.8}, kMaxUn / 2));
  EXPECT_FALSE(has_moved({.zoom = 0.005}, kMaxUn));
  EXPECT_EQ(has_moved({.x_px = 2}, kMaxUn), has_moved({.x_px = 2}, 5 * kMaxUn)) << "no more than at the most";
}

TEST_F(RimMotionTest, AStiffWallMovesItsRimAsItsCalibrationSays) {
  RimMotion stiff({.shift_q16 = 2 << 16, .zoom_q16 = 3 << 16});
  stiff.learn(moved({}));
  EXPECT_FALSE(stiff.has_moved(moved({.zoom = 0.02}), kMaxUn, kMaxUn));
  EXPECT_TRUE(has_moved({.zoom = 0.02}, kMaxUn));
  EXPECT_FALSE(stiff.has_moved(moved({.x_px = 0.9}), kMaxUn / 2, kMaxUn));
  EXPECT_TRUE(stiff.has_moved(moved({.x_px = 1.2}), kMaxUn / 2, kMaxUn));
  EXPECT_TRUE(stiff.has_moved(moved({.zoom = 0.002}), 0, kMaxUn)) << "nothing presses";
}

TEST_F(RimMotionTest, ADentOfOneSectorIsNoMotion) { EXPECT_FALSE(has_moved({.dent_px = 5})); }

TEST_F(RimMotionTest, ASectorThatIsNotSeenSaysNothing) {
  auto markers = moved({.x_px = 1});
  const auto lose = [&](double from_x, double to_x) {
    for (Marker& m : markers) {
      const double x = m.rest_x.raw() / 65'536.0;
      m.is_lost = m.is_lost || (x >= from_x && x < to_x);
    }
  };
  lose(220, 300);
  EXPECT_TRUE(rim_.has_moved(markers, 0, kMaxUn)) << "three are left";
  lose(0, 100);
  EXPECT_FALSE(rim_.has_moved(markers, 0, kMaxUn));
}

}  // namespace
}  // namespace ruffini
