#include "solve/support_solver.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "support/held_calibration.h"

namespace ruffini {
namespace {

constexpr int kNodes = 4;
constexpr int kUnknowns = 3 * kNodes;
constexpr int64_t kThreshold = 10;
constexpr uint8_t kSurely = 128;

using Matrix = std::array<std::array<double, kUnknowns>, kUnknowns>;

// H = 1 on the diagonal, `coupling` between an unknown and the next one: well conditioned below 0.5.
Matrix tridiagonal(double coupling) {
  Matrix h{};
  for (size_t i = 0; i < kUnknowns; ++i) {
    h[i][i] = 1;
    if (i + 1 < kUnknowns) h[i][i + 1] = h[i + 1][i] = coupling;
  }
  return h;
}

// Solution of H_SS y = b_S by elimination, in float64.
std::vector<double> eliminate(const Matrix& h, std::vector<double> b, const std::vector<size_t>& support) {
  const size_t n = support.size();
  std::vector<std::vector<double>> a(n, std::vector<double>(n));
  for (size_t i = 0; i < n; ++i) {
    for (size_t j = 0; j < n; ++j) a[i][j] = h[support[i]][support[j]];
  }
  for (size_t k = 0; k < n; ++k) {
    for (size_t i = k + 1; i < n; ++i) {
      const double factor = a[i][k] / a[k][k];
      for (size_t j = k; j < n; ++j) a[i][j] -= factor * a[k][j];
      b[i] -= factor * b[k];
    }
  }
  for (size_t k = n; k-- > 0;) {
    for (size_t j = k + 1; j < n; ++j) b[k] -= a[k][j] * b[j];
    b[k] /= a[k][k];
  }
  return b;
}

// Tables of H (8 fraction bits beside Q14) and of the projection b = 64 u, force = 4 y.
class Loaded {
 public:
  explicit Loaded(const Matrix& h) {
    std::vector<int16_t> normal(kUnknowns * kUnknowns);
    std::vector<int16_t> project(kUnknowns * kUnknowns);
    for (size_t i = 0; i < kUnknowns; ++i) {
      for (size_t j = 0; j < kUnknowns; ++j)
        normal[i * kUnknowns + j] = static_cast<int16_t>(std::lround(h[i][j] * 8192));
      project[i * kUnknowns + i] = 8192;
    }
    file_ = test::held(test::CalibrationBytes()
                           .meta("kinds", "support")
                           .meta("support.normal.out_shift", "5")   // 8192 / 2^5 = 256: 8 fraction bits
                           .meta("support.project.out_shift", "7")  // 8192 / 2^7 = 64
                           .meta("support.shear_noise", "0")
                           .tensor("support.scale", "I32", {kUnknowns}, std::vector<int32_t>(kUnknowns, 4 << 16))
                           .dense_program("support.normal", kUnknowns, kUnknowns)
                           .dense_program("support.project", kUnknowns, kUnknowns)
                           .dense_entries("support.normal", kUnknowns, kUnknowns, normal)
                           .dense_entries("support.project", kUnknowns, kUnknowns, project)
                           .dense_shifts("support.normal", kUnknowns, kUnknowns)
                           .dense_shifts("support.project", kUnknowns, kUnknowns));
    const std::vector<NodePlace> places = {{-1500, 0}, {-500, 0}, {500, 0}, {1500, 0}};
    auto loaded = SupportSolver::load(file_->get(), {kNodes, 1}, places);
    EXPECT_TRUE(loaded.has_value()) << (loaded ? "" : loaded.error().message);
    solver_.emplace(std::move(loaded).value());
  }
  SupportSolver& solver() { return *solver_; }

 private:
  std::shared_ptr<const CalibrationFile> file_;
  std::optional<SupportSolver> solver_;
};

double component(const NodeForce& f, size_t i) { return i == 0 ? f.x : i == 1 ? f.y : f.z; }

// Steps of force of an unknown: y is Q14 of units whose force is 4 Q16-scaled steps, F = y 4 2^16 / 2^30.
double force_of(double y) { return y * 4 / 16'384; }

TEST(SupportSolver, SolvesTheSupportAndLeavesZeroOutside) {
  const Matrix h = tridiagonal(0.1);
  Loaded loaded(h);
  std::vector<int16_t> u(kUnknowns);
  for (size_t i = 0; i < kUnknowns; ++i) {
    u[i] = static_cast<int16_t>(i % 3 == 2 ? -9'000 : 1000 * std::sin(static_cast<double>(i)) + 400);
  }
  const std::vector<uint8_t> mask = {0, kSurely, kSurely, 0};
  const std::vector<size_t> support = {3, 4, 5, 6, 7, 8};
  std::vector<double> b;
  for (const size_t i : support) b.push_back(64.0 * u[i]);
  const std::vector<double> y = eliminate(h, b, support);
  std::vector<NodeForce> force(kNodes, {77, 77, -77});  // a bad first guess
  SaturationCounter saturations;
  loaded.solver().run(u, {}, mask, kThreshold, force, saturations);
  double largest = 0;
  for (const double value : y) largest = std::max(largest, std::abs(value));
  for (size_t i = 0; i < support.size(); ++i) {
    EXPECT_NEAR(component(force[support[i] / 3], support[i] % 3), force_of(y[i]), 0.51 + 1e-3 * force_of(largest)) << i;
  }
  for (const size_t node : {size_t{0}, size_t{3}}) {
    EXPECT_EQ(force[node].x, 0);
    EXPECT_EQ(force[node].y, 0);
    EXPECT_EQ(force[node].z, 0);
  }
  EXPECT_EQ(saturations.count, 0U);
}

// H is almost one: what is left is of the unknowns that may not move, and next to nothing of the support.
TEST(SupportSolver, LeavesWhatItsForcesDoNotExplain) {
  const Matrix h = tridiagonal(0.1);
  Loaded loaded(h);
  std::vector<int16_t> u(kUnknowns);
  for (size_t i = 0; i < kUnknowns; ++i) {
    u[i] = static_cast<int16_t>(i % 3 == 2 ? -9'000 : 1000 * std::sin(static_cast<double>(i)) + 400);
  }
  const std::vector<uint8_t> mask = {0, kSurely, kSurely, 0};
  std::vector<NodeForce> force(kNodes, {77, 77, -77});
  SaturationCounter saturations;
  loaded.solver().run(u, {}, mask, kThreshold, force, saturations);
  std::vector<int32_t> left(kUnknowns);
  loaded.solver().residual(u, left, saturations);
  for (size_t i = 0; i < kUnknowns; ++i) {
    double r = 64.0 * u[i];  // Q14
    for (size_t j = 0; j < kUnknowns; ++j) r -= h[i][j] * component(force[j / 3], j % 3) * 4'096;
    EXPECT_NEAR(left[i], r / 256, 20) << i;  // forces are whole steps of 4096 / 256 = 16
  }
  EXPECT_GT(std::abs(left[2]), 2'000) << "nothing presses there";
  EXPECT_LT(std::abs(left[5]), 40) << "and here it does";
  EXPECT_EQ(saturations.count, 0U);
  // The next frame's forces are what they would be without it, and with unknowns that are watched.
  const std::vector<uint32_t> watched = {0, 2, 5, 11};
  loaded.solver().watch(watched);
  std::vector<NodeForce> again(kNodes, {77, 77, -77});
  loaded.solver().run(u, {}, mask, kThreshold, again, saturations);
  std::vector<int32_t> at_watched(watched.size());
  loaded.solver().watched_residual(at_watched);
  for (size_t i = 0; i < watched.size(); ++i) EXPECT_NEAR(at_watched[i], left[watched[i]], 2) << watched[i];
  for (size_t i = 0; i < kUnknowns; ++i) {
    EXPECT_EQ(component(again[i / 3], i % 3), component(force[i / 3], i % 3));
  }
}

TEST(SupportSolver, AResidualThatIsTooLargeIsHeldAndCounted) {
  Loaded loaded(tridiagonal(0.1));
  const std::vector<int16_t> u(kUnknowns, 0);
  std::vector<NodeForce> force(kNodes);
  const std::vector<NodeForce> beyond(kNodes, {INT32_MAX, INT32_MAX, INT32_MAX});
  SaturationCounter of_forces, of_residual;
  loaded.solver().run(u, beyond, std::vector<uint8_t>(kNodes, 0), kThreshold, force, of_forces);
  std::vector<int32_t> left(kUnknowns);
  loaded.solver().residual(u, left, of_residual);
  EXPECT_EQ(of_residual.count, uint64_t{kUnknowns}) << "row sums of H are above one";
  for (const int32_t value : left) EXPECT_EQ(value, 1 << 23);  // 2^31 of Q14 as Q6
}

TEST(SupportSolver, ANodeThatWouldPullLosesItsForce) {
  Loaded loaded(tridiagonal(0));  // b is y: the first round finds it at once
  std::vector<int16_t> u(kUnknowns);
  for (const size_t node : {size_t{1}, size_t{2}}) u[3 * node] = 9'000;  // both sheared
  u[3 * 1 + 2] = -9'000;
  u[3 * 2 + 2] = 9'000;
  std::vector<NodeForce> force(kNodes, {0, 0, -50});
  SaturationCounter saturations;
  loaded.solver().run(u, {}, std::vector<uint8_t>{0, kSurely, kSurely, 0}, kThreshold, force, saturations);
  EXPECT_NEAR(force[1].x, force_of(64 * 9'000), 1);
  EXPECT_NEAR(force[1].z, force_of(-64 * 9'000), 1);
  EXPECT_EQ(force[2].x, 0);
  EXPECT_EQ(force[2].z, 0);
}

TEST(SupportSolver, ANodeBelowTheThresholdKeepsItsFreedomWhileItPresses) {
  Loaded loaded(tridiagonal(0));
  std::vector<int16_t> u(kUnknowns);
  for (const size_t node : {size_t{1}, size_t{2}}) u[3 * node] = 9'000;
  u[3 * 1 + 2] = -9'000;
  u[3 * 2 + 2] = -320;  // a pressure of half the threshold
  std::vector<NodeForce> force(kNodes);
  SaturationCounter saturations;
  loaded.solver().run(u, {}, std::vector<uint8_t>{0, kSurely, kSurely, 0}, kThreshold, force, saturations);
  EXPECT_NEAR(force_of(-64 * 320), -0.5 * kThreshold, 0.01);
  EXPECT_NEAR(force[2].x, force_of(64 * 9'000), 1);
}

// Also right after a contact, nothing of which remains; and the residual equals u.
TEST(SupportSolver, AnEmptyMaskIsNoForce) {
  Loaded loaded(tridiagonal(0.3));
  const std::vector<uint32_t> watched = {0, 4, 11};
  loaded.solver().watch(watched);
  const std::vector<int16_t> u(kUnknowns, -9'000);
  std::vector<NodeForce> force(kNodes);
  SaturationCounter saturations;
  std::vector<int32_t> at_watched(watched.size());
  const std::vector<uint8_t> masks[] = {std::vector<uint8_t>(kNodes), std::vector<uint8_t>(kNodes, kSurely),
                                        std::vector<uint8_t>(kNodes)};
  for (const std::vector<uint8_t>& mask : masks) {
    std::fill(force.begin(), force.end(), NodeForce{5, 6, -7});
    loaded.solver().run(u, {}, mask, kThreshold, force, saturations);
    loaded.solver().watched_residual(at_watched);
    const bool is_touched = mask[0] != 0;
    for (const NodeForce& f : force) EXPECT_EQ(f.z != 0, is_touched);
    // Q14 of u as Q6.
    EXPECT_EQ(at_watched != std::vector<int32_t>(watched.size(), -64 * 9'000 / 256), is_touched);
  }
  std::vector<int32_t> left(kUnknowns);
  loaded.solver().residual(u, left, saturations);
  EXPECT_EQ(left, std::vector<int32_t>(kUnknowns, -9'000 / 4));
}

TEST(SupportSolver, StaysBoundedWhenTheTablesAreNotPositive) {
  Matrix h = tridiagonal(0);
  for (size_t i = 0; i < kUnknowns; ++i) h[i][i] = -1;  // curvature below zero: no step may be taken
  Loaded loaded(h);
  std::vector<NodeForce> force(kNodes, {100, 100, -100});
  SaturationCounter saturations;
  loaded.solver().run(std::vector<int16_t>(kUnknowns, 32767), {}, std::vector<uint8_t>(kNodes, kSurely), kThreshold,
                      force, saturations);
  for (const NodeForce& f : force) EXPECT_EQ(f.z, -100);
}

}  // namespace
}  // namespace ruffini
