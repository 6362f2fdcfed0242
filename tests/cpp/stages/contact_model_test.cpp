#include "stages/contact_model/contact_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "stages/contact_model/contact_profile.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

constexpr int kX = 25;
constexpr int kY = 19;

BoardSettings board() {
  BoardSettings board = test::round_board();
  board.markers.lattice = {kX, kY};
  board.markers.pitch_x_um = board.markers.pitch_y_um = 600;
  board.markers.first_x_um = 800;
  board.markers.first_y_um = 600;
  return board;
}

// Patches moved outwards from (x, y), by `push` px where they are 2 mm away, and all by a shift.
std::vector<Marker> flow(double x_um, double y_um, double push_px, double shift_px) {
  std::vector<Marker> out(kX * kY);
  for (int j = 0; j < kY; ++j) {
    for (int i = 0; i < kX; ++i) {
      const double dx = 800.0 + 600.0 * i - 8'000.0 - x_um;
      const double dy = 600.0 + 600.0 * j - 6'000.0 - y_um;
      const double r = std::hypot(dx, dy) / 2'000.0;
      const double size = push_px * std::exp(1 - r) / 2'000.0;
      Marker& m = out[static_cast<size_t>(j * kX + i)];
      m.displacement_x = ImagePx::from_raw(static_cast<int32_t>(65'536 * (size * dx + shift_px)));
      m.displacement_y = ImagePx::from_raw(static_cast<int32_t>(65'536 * size * dy));
      m.is_lost = m.is_absent = false;
    }
  }
  return out;
}

TEST(ContactProfile, FindsTheMiddleAndHowFarTheFlowGoesOut) {
  ContactProfile profile(board());
  const auto markers = flow(700, -400, 1.0, 0.0);
  const Profile& p = profile.run(markers);
  EXPECT_NEAR(static_cast<double>(p.center_x_um), 700, 60);
  EXPECT_NEAR(static_cast<double>(p.center_y_um), -400, 60);
  // A ring a 36th of 12 mm apart; 100 um a pixel. The sixth is 1,998 um from the middle.
  EXPECT_NEAR(static_cast<double>(p.radial_q4[5]) / 16, 100, 3);
  EXPECT_GT(p.fall_q16, 4'000);
  EXPECT_EQ(p.lost_1e3, 0);
}

TEST(ContactProfile, WhatAllPatchesHaveInCommonFallsOut) {
  ContactProfile profile(board());
  const Profile still = profile.run(flow(0, 0, 1.0, 0.0));
  const Profile moved = profile.run(flow(0, 0, 1.0, 5.0));
  for (size_t i = 0; i < Profile::kRings; ++i) {
    EXPECT_NEAR(static_cast<double>(moved.radial_q4[i]), static_cast<double>(still.radial_q4[i]), 2) << i;
  }
  const Profile shift = profile.run(flow(0, 0, 0.0, 5.0));
  EXPECT_EQ(shift.fall_q16, 0);
  EXPECT_EQ(shift.size_q4, 0);
}

TEST(ContactProfile, CountsLostPatchesAboutTheContactAlone) {
  ContactProfile profile(board());
  auto markers = flow(-3'000, 0, 1.0, 0.0);
  for (int j = 0; j < kY; ++j) markers[static_cast<size_t>(j * kX + kX - 1)].is_lost = true;
  EXPECT_EQ(profile.run(markers).lost_1e3, 0);
  for (Marker& m : markers) m.is_lost = true;
  EXPECT_EQ(profile.run(markers).lost_1e3, 1'000);
}

TEST(ContactModel, Log2InSteps) {
  EXPECT_EQ(log2_q10(0), 0);
  EXPECT_EQ(log2_q10(1), 0);
  EXPECT_EQ(log2_q10(2), 1'024);
  EXPECT_EQ(log2_q10(int64_t{1} << 40), 40 * 1'024);
  EXPECT_NEAR(static_cast<double>(log2_q10(1'000'000)), 1'024 * std::log2(1e6), 1.0);
  EXPECT_NEAR(static_cast<double>(log2_q10(3)), 1'024 * std::log2(3.0), 1.0);
}

}  // namespace
}  // namespace ruffini
