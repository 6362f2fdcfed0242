#include "stages/feature_wrench/corner_motion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>
#include <vector>

#include "frame_calibration.h"
#include "support/calibration_bytes.h"

namespace ruffini {
namespace {

constexpr GridSize kLattice{30, 24};
constexpr double kPitchPx = 8;

struct Way {
  double x_px = 0;
  double y_px = 0;
  double turn = 0;
  double zoom = 0;
  double press_px = 0;  // outwards, most at 20 px from the middle of the contact
  double press_x_px = 0;
};

std::vector<Marker> moved(const Way& way) {
  const auto raw = [](double px) { return ImagePx::from_raw(static_cast<int32_t>(std::lround(65'536 * px))); };
  std::vector<Marker> out;
  for (int j = 0; j < kLattice.n_y; ++j) {
    for (int i = 0; i < kLattice.n_x; ++i) {
      const double x = kPitchPx * (i - 14.5);
      const double y = kPitchPx * (j - 11.5);
      const double r = std::hypot(x - way.press_x_px, y) / 20;
      const double out_of_it = way.press_px * std::exp(0.5 - r * r / 2) / 20;
      Marker m;
      m.rest_x = raw(x + 160);
      m.rest_y = raw(y + 120);
      m.displacement_x = raw(way.x_px + way.zoom * x - way.turn * y + out_of_it * (x - way.press_x_px));
      m.displacement_y = raw(way.y_px + way.zoom * y + way.turn * x + out_of_it * y);
      m.is_lost = m.is_absent = false;
      out.push_back(m);
    }
  }
  return out;
}

// 0.2 N a pixel of shift along x and y; 400 N a unit of zoom along z.
FeatureWrench wrench() {
  const int n = kLattice.count();
  std::vector<int32_t> gain(static_cast<size_t>(12 * n));
  const auto rest = moved({});
  double square = 0;
  const auto px = [](ImagePx p, double middle) { return p.raw() / 65'536.0 - middle; };
  for (const Marker& m : rest) square += std::pow(px(m.rest_x, 160), 2) + std::pow(px(m.rest_y, 120), 2);
  for (int i = 0; i < n; ++i) {
    const auto at = static_cast<size_t>(2 * i);
    const double per_px = 16.0 * 1e6 * (1 << 12) / 65'536;  // 1/16 uN of Q16 px, shifted
    gain[at] = gain[static_cast<size_t>(2 * n) + at + 1] = static_cast<int32_t>(std::lround(0.2 * per_px / n));
    gain[static_cast<size_t>(4 * n) + at] =
        static_cast<int32_t>(std::lround(-400 * per_px * px(rest[at / 2].rest_x, 160) / square));
    gain[static_cast<size_t>(4 * n) + at + 1] =
        static_cast<int32_t>(std::lround(-400 * per_px * px(rest[at / 2].rest_y, 120) / square));
  }
  const auto same = [](size_t n_values, int32_t value) { return std::vector<int32_t>(n_values, value); };
  test::CalibrationBytes file;
  file.meta("kinds", "wrench").meta("wrench.features", "markers");
  file.meta("board", "any").meta("optics", "any").meta("resolution", "320x240").meta("sensor_serial", "*");
  file.meta("gel_serial", "*").meta("created_utc", "2026-11-24T00:00:00Z");
  file.tensor("wrench.error", "I32", {2, 6, 6}, same(72, 0))
      .tensor("wrench.full_scale", "I32", {6}, same(6, 1'000'000'000))
      .tensor("wrench.gain", "I32", {6, 2 * n}, gain)
      .tensor("wrench.square", "I32", {6, 21}, same(126, 0));
  const auto bytes = file.tensor("wrench.shift", "U8", {6}, std::vector<uint8_t>(6, 12)).bytes();
  return FeatureWrench::load(CalibrationFile::load(bytes).value()->get(), "markers", 2 * n).value();
}
bool has_moved(const std::vector<Marker>& markers, int64_t force_z_un = 0) {
  CornerMotion corners(kLattice);
  corners.learn(moved({}), wrench());
  return corners.has_moved(markers, {.force_z_un = force_z_un});
}

TEST(CornerMotion, TellsWhatTheCornersHaveInCommon) {
  CornerMotion corners(kLattice);
  corners.learn(moved({}), wrench());
  const auto seen = corners.motion(moved({.x_px = 0.5, .y_px = -0.25, .turn = 0.01, .zoom = -0.002}));
  EXPECT_NEAR(static_cast<double>(seen.zoom_q20) / (1 << 20), 0.002, 1e-5);
  EXPECT_NEAR(static_cast<double>(seen.turn_q20) / (1 << 20), 0.01, 1e-5);
  const auto shifted = corners.motion(moved({.x_px = 0.5, .y_px = -0.25}));
  EXPECT_NEAR(static_cast<double>(shifted.shift_x_q16) / 65'536, 0.5, 1e-3);
  EXPECT_NEAR(static_cast<double>(shifted.shift_y_q16) / 65'536, 0.25, 1e-3);
}

TEST(CornerMotion, AMotionCountsByTheForceThatItMakes) {
  EXPECT_FALSE(has_moved(moved({.zoom = 0.0002})));  // 0.08 N
  EXPECT_TRUE(has_moved(moved({.zoom = 0.0003})));   // 0.12 N
  EXPECT_TRUE(has_moved(moved({.zoom = -0.0003})));
  EXPECT_FALSE(has_moved(moved({.zoom = 0.0003}), -1'000'000));
  EXPECT_TRUE(has_moved(moved({.zoom = 0.0006}), -1'000'000));
  EXPECT_FALSE(has_moved(moved({.y_px = 0.4})));
  EXPECT_TRUE(has_moved(moved({.y_px = 0.5})));
  EXPECT_TRUE(has_moved(moved({.turn = 0.025})));  // its picture is smaller by half its square: 0.12 N
}

TEST(CornerMotion, APressIsNone) {
  for (const double x_px : {-60.0, 0.0, 40.0}) {
    EXPECT_FALSE(has_moved(moved({.press_px = 3, .press_x_px = x_px}), -2'000'000)) << x_px;
  }
  EXPECT_TRUE(has_moved(moved({.zoom = 0.002, .press_px = 3}), -2'000'000));
}

TEST(CornerMotion, ACornerWhoseMarkersAreLostSaysNothing) {
  auto markers = moved({.zoom = 0.002});
  const auto lose = [&](int first_x, int first_y) {
    for (int j = 0; j < 5; ++j) {
      for (int i = 0; i < 5; ++i)
        markers[static_cast<size_t>((first_y + j) * kLattice.n_x + first_x + i)].is_lost = true;
    }
  };
  lose(0, 0);
  EXPECT_TRUE(has_moved(markers)) << "three are left";
  lose(25, 19);
  EXPECT_FALSE(has_moved(markers));
}

}  // namespace
}  // namespace ruffini
