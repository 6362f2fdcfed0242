#include "stages/helmholtz/helmholtz.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include "support/test_board.h"

namespace ruffini {
namespace {

constexpr int kX = 34;
constexpr int kY = 26;
constexpr double kStepXUm = 1'000.0;
constexpr double kStepYUm = 800.0;

BoardSettings board() {
  BoardSettings board = test::round_board();
  board.markers.lattice = {kX, kY};
  board.markers.pitch_x_um = 1'000;
  board.markers.pitch_y_um = 800;
  board.pad.size_x_um = 36'000;
  board.pad.size_y_um = 22'000;
  board.markers.first_x_um = 1'500;
  board.markers.first_y_um = 1'000;
  return board;
}

template <typename Make>
std::vector<FlowPoint> field(Make make) {
  std::vector<FlowPoint> out;
  for (int y = 0; y < kY; ++y) {
    for (int x = 0; x < kX; ++x) {
      const auto [along_x, along_y] = make(x + 0.5, y + 0.5);
      out.push_back({std::llround(16 * along_x), std::llround(16 * along_y)});
    }
  }
  return out;
}

struct Um {
  double x;
  double y;
};

// Gradient of cos(pi a x / n_x) cos(pi b y / n_y): no slope across the border.
Um gradient_of_a_wave(double x, double y) {
  constexpr double kA = 3 * std::numbers::pi / kX;
  constexpr double kB = 2 * std::numbers::pi / kY;
  constexpr double kSizeUm = 1.5e6;
  return {-kSizeUm * kA / kStepXUm * std::sin(kA * x) * std::cos(kB * y),
          -kSizeUm * kB / kStepYUm * std::cos(kA * x) * std::sin(kB * y)};
}

// A turn by 40 mrad about the middle, which dies out before the border.
Um turn(double x, double y) {
  const double dx = (x - kX / 2.0) * kStepXUm;
  const double dy = (y - kY / 2.0) * kStepYUm;
  const double size = 0.04 * std::exp(-(dx * dx + dy * dy) / (2 * 2'500.0 * 2'500.0));
  return {-size * dy, size * dx};
}

double worst_um(const Helmholtz& helmholtz, const std::vector<FlowPoint>& expected) {
  double worst = 0;
  for (size_t i = 0; i < expected.size(); ++i) {
    const FlowPoint& g = helmholtz.curl_free()[i];
    worst = std::max(worst, std::hypot(static_cast<double>(g.x_q4 - expected[i].x_q4),
                                       static_cast<double>(g.y_q4 - expected[i].y_q4)) /
                                16);
  }
  return worst;
}

TEST(Helmholtz, AGradientIsCurlFree) {
  Helmholtz helmholtz(board());
  SaturationCounter saturations;
  const auto u = field(gradient_of_a_wave);
  const HelmholtzSums& sums = helmholtz.run(u, Profile{}, saturations);
  double size = 0;
  for (const FlowPoint& v : u) size += std::hypot(static_cast<double>(v.x_q4), static_cast<double>(v.y_q4));
  EXPECT_GT(size / 16 / (kX * kY), 150);
  EXPECT_NEAR(static_cast<double>(sums.curl_free_q4), size / (kX * kY), 16 * 3);
  EXPECT_LT(worst_um(helmholtz, u), 5);
  EXPECT_NEAR(static_cast<double>(sums.twist_urad), 0, 300);
  EXPECT_EQ(saturations.count, 0);
}

TEST(Helmholtz, ATurnIsFreeOfDivergence) {
  Helmholtz helmholtz(board());
  SaturationCounter saturations;
  const HelmholtzSums& sums = helmholtz.run(field(turn), Profile{}, saturations);
  EXPECT_LT(sums.curl_free_q4, 16 / 2);
  EXPECT_LT(sums.divergence_free_q4, 16 / 2);  // a turn has no mean
  // Mean of 0.04 (1 - r^2 / 2 s^2) exp(-r^2 / 2 s^2), s = 2.5 mm, over the patches within 2 mm.
  EXPECT_NEAR(static_cast<double>(sums.twist_urad), 28'000, 4'000);
  Profile beside;
  beside.center_x_um = 13'000;
  EXPECT_NEAR(static_cast<double>(helmholtz.run(field(turn), beside, saturations).twist_urad), 0, 100);
}

TEST(Helmholtz, TheirSumComesApartAndAShiftStaysWithTheTurn) {
  Helmholtz helmholtz(board());
  SaturationCounter saturations;
  const auto u = field([](double x, double y) {
    const Um g = gradient_of_a_wave(x, y);
    const Um r = turn(x, y);
    return Um{g.x + r.x + 300.0, g.y + r.y - 400.0};
  });
  const auto only_gradient = field(gradient_of_a_wave);
  const HelmholtzSums& sums = helmholtz.run(u, Profile{}, saturations);
  EXPECT_LT(worst_um(helmholtz, only_gradient), 8);
  EXPECT_NEAR(static_cast<double>(sums.divergence_free_q4), 16 * 500, 16 * 5);
}

TEST(Helmholtz, NoFlowHasNoParts) {
  Helmholtz helmholtz(board());
  SaturationCounter saturations;
  const HelmholtzSums& sums = helmholtz.run(std::vector<FlowPoint>(kX * kY), Profile{}, saturations);
  EXPECT_EQ(sums.curl_free_q4, 0);
  EXPECT_EQ(sums.divergence_free_q4, 0);
  EXPECT_EQ(sums.twist_urad, 0);
}

TEST(Helmholtz, WhatIsTooFarIsHeldAndCounted) {
  Helmholtz helmholtz(board());
  SaturationCounter saturations;
  std::vector<FlowPoint> u(kX * kY);
  u[100] = {int64_t{1} << 40, -(int64_t{1} << 40)};
  (void)helmholtz.run(u, Profile{}, saturations);
  EXPECT_EQ(saturations.count, 2);
}

}  // namespace
}  // namespace ruffini
