#include "image/poisson.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

#include "support/test_board.h"

namespace ruffini {
namespace {

constexpr double kStandoffUm = 20'000;
constexpr double kStepUm = 0.125;

struct Field {
  std::vector<CellSlope> slope;
  std::vector<double> w_um;  // H ln(1 + z / H), any constant added
};

// Slopes of a surface given by w(x', y') and its gradient along the rays: s = g / (1 + g . x').
Field field_of(const BoardSettings& board, const std::function<double(double, double)>& w,
               const std::function<std::pair<double, double>(double, double)>& gradient) {
  Field out;
  const int step = board.depth.step_px;
  for (int y = 0; y < board.camera.height_px / step; ++y) {
    for (int x = 0; x < board.camera.width_px / step; ++x) {
      const double ray_x = (x * step + (step - 1) / 2.0 - 79.5) / 200;
      const double ray_y = (y * step + (step - 1) / 2.0 - 59.5) / 200;
      const auto [gx, gy] = gradient(ray_x, ray_y);
      const double scale = 4096 / (1 + gx * ray_x + gy * ray_y);
      out.slope.push_back({Slope::from_raw(static_cast<int16_t>(std::lround(gx * scale))),
                           Slope::from_raw(static_cast<int16_t>(std::lround(gy * scale)))});
      out.w_um.push_back(w(ray_x, ray_y) * kStandoffUm);
    }
  }
  return out;
}

struct Solved {
  std::vector<double> z_um;
  uint64_t saturations = 0;
};

Solved solve(const BoardSettings& board, const std::vector<CellSlope>& slope) {
  Poisson poisson(board);
  std::vector<DisplacementUm> depth(slope.size());
  SaturationCounter counter;
  poisson.run(slope, depth, counter);
  Solved out;
  for (const DisplacementUm z : depth) out.z_um.push_back(z.raw() * kStepUm);
  out.saturations = counter.count;
  return out;
}

// RMS of the error of w once the free constant is removed.
double rms_error_um(const Solved& solved, const Field& field) {
  double sum = 0;
  double squares = 0;
  const auto n = static_cast<double>(field.w_um.size());
  for (size_t i = 0; i < field.w_um.size(); ++i) {
    const double error = kStandoffUm * std::log1p(solved.z_um[i] / kStandoffUm) - field.w_um[i];
    sum += error;
    squares += error * error;
  }
  return std::sqrt(squares / n - sum * sum / n / n);
}

TEST(Poisson, NoSlopeIsNoDepth) {
  const BoardSettings board = test::round_board();
  const Solved solved = solve(board, std::vector<CellSlope>(160 * 120));
  for (const double z : solved.z_um) EXPECT_EQ(z, 0);
}

TEST(Poisson, ReproducesADentToOneStep) {
  for (const int step : {1, 2}) {
    BoardSettings board = test::round_board();
    board.depth.step_px = step;
    const double radius = 0.25;
    const auto inside = [&](double x, double y) {
      return std::max(radius * radius - (x - 0.05) * (x - 0.05) - y * y, 0.0);
    };
    const double height = 600 / kStandoffUm / std::pow(radius, 4);
    const Field field = field_of(
        board, [&](double x, double y) { return -height * inside(x, y) * inside(x, y); },
        [&](double x, double y) {
          return std::pair{4 * height * inside(x, y) * (x - 0.05), 4 * height * inside(x, y) * y};
        });
    const Solved solved = solve(board, field.slope);
    // What remains is the second-order error of averaging slopes to half-way points: it grows with the cell.
    EXPECT_LT(rms_error_um(solved, field), step * kStepUm) << "step " << step;
    EXPECT_EQ(solved.saturations, 0U);
  }
}

TEST(Poisson, ReproducesAWaveToOneStep) {
  const BoardSettings board = test::round_board();
  const double k = 3 * std::numbers::pi / 0.8;  // flat at both borders: 160 px are 0.8 of the focal length
  const double amplitude = 50 / kStandoffUm;
  const Field field = field_of(
      board, [&](double x, double) { return amplitude * std::cos(k * (x + 0.4)); },
      [&](double x, double) { return std::pair{-amplitude * k * std::sin(k * (x + 0.4)), 0.0}; });
  EXPECT_LT(rms_error_um(solve(board, field.slope), field), kStepUm);
}

// A plane z = a X is seen at z = a x' H / (1 - a x'): exact in perspective, along each axis.
TEST(Poisson, ReproducesTiltedPlanesInPerspective) {
  const BoardSettings board = test::round_board();
  for (const int raw : {-820, -41, 41, 205, 820}) {  // 1 to 20 %
    for (const bool is_x : {true, false}) {
      const double a = raw / 4096.0;
      const auto s = static_cast<int16_t>(raw);
      const std::vector<CellSlope> slope(
          160 * 120, {Slope::from_raw(is_x ? s : int16_t{0}), Slope::from_raw(is_x ? int16_t{0} : s)});
      Field field{slope, {}};
      for (int y = 0; y < 120; ++y) {
        for (int x = 0; x < 160; ++x) {
          const double ray = is_x ? (x - 79.5) / 200 : (y - 59.5) / 200;
          field.w_um.push_back(-kStandoffUm * std::log(1 - a * ray));
        }
      }
      // Rounding of 1 / (1 - e) to 14 bits, a coherent error here, allows 1e-4 of the plane's height.
      const double height_um = std::abs(a) * kStandoffUm * 0.8;
      EXPECT_LT(rms_error_um(solve(board, slope), field), kStepUm + 1e-4 * height_um) << raw << (is_x ? " x" : " y");
    }
  }
}

TEST(Poisson, MeanDepthOverTheMarginIsZero) {
  BoardSettings board = test::round_board();
  board.markers.first_x_um = 2'000;
  const std::vector<CellSlope> slope(160 * 120, {Slope::from_raw(30), Slope::from_raw(-20)});
  const Solved solved = solve(board, slope);
  double sum = 0;
  int n = 0;
  for (int y = 0; y < 120; ++y) {
    for (int x = 0; x < 160; ++x) {
      if (x >= 10 && x < 150 && y >= 10 && y < 110) continue;  // margin 1 mm = 10 px
      sum += kStandoffUm * std::log1p(solved.z_um[static_cast<size_t>(y * 160 + x)] / kStandoffUm);
      ++n;
    }
  }
  EXPECT_NEAR(sum / n, 0, 0.1);
}

TEST(Poisson, ImpossibleSlopesSaturateAndAreCounted) {
  const std::vector<CellSlope> slope(160 * 120, {Slope::from_raw(32767), Slope::from_raw(32767)});
  EXPECT_GT(solve(test::round_board(), slope).saturations, 0U);
}

}  // namespace
}  // namespace ruffini
