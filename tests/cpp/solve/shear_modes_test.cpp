#include "solve/shear_modes.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numeric>

#include "solve/components.h"

namespace ruffini {
namespace {

constexpr GridSize kGrid{9, 7};
constexpr int kStepUm = 500;
constexpr int64_t kOne = int64_t{1} << 20;  // of y

std::vector<NodePlace> places() {
  std::vector<NodePlace> out;
  for (int row = 0; row < kGrid.n_y; ++row) {
    for (int column = 0; column < kGrid.n_x; ++column) {
      out.push_back({(column - kGrid.n_x / 2) * kStepUm, (row - kGrid.n_y / 2) * kStepUm});
    }
  }
  return out;
}

// Every node touched; a pressure that falls from the middle; shear by the caller.
struct Field {
  Field() {
    for (uint32_t i = 0; i < 3U * static_cast<uint32_t>(kGrid.count()); ++i) index.push_back(i);
    y.assign(index.size(), 0);
    for (size_t k = 0; k < where.size(); ++k) y[3 * k + 2] = -static_cast<int64_t>(pressure(k) * kOne);
  }
  [[nodiscard]] double pressure(size_t k) const {
    return 1 - (std::pow(where[k].x_um, 2) + std::pow(where[k].y_um, 2)) / 8e6;
  }
  std::vector<NodePlace> where = places();
  std::vector<uint8_t> mask = std::vector<uint8_t>(static_cast<size_t>(kGrid.count()), 128);
  std::vector<uint32_t> index;
  std::vector<int64_t> weight = std::vector<int64_t>(3 * static_cast<size_t>(kGrid.count()), 128);
  std::vector<int64_t> y;
};

ShearModes learned(const Field& f, int64_t noise_y) {
  ShearModes modes(kGrid, f.where, noise_y);
  modes.assign(f.mask, f.index);
  modes.learn(f.y, f.weight);
  return modes;
}

TEST(ShearModes, WhatContactsCarryIsKeptUnderMuchNoise) {
  Field f;
  for (size_t k = 0; k < f.where.size(); ++k) {
    // pushed along x, twisted
    f.y[3 * k] = std::lround(kOne * f.pressure(k) * (0.3 - 1e-4 * f.where[k].y_um));
    f.y[3 * k + 1] = std::lround(kOne * f.pressure(k) * 1e-4 * f.where[k].x_um);
  }
  const std::vector<int64_t> before = f.y;
  learned(f, kOne).shrink(f.y, f.weight);
  for (size_t i = 0; i < f.y.size(); ++i) EXPECT_LT(std::abs(f.y[i] - before[i]), kOne / 1000) << i;
}

TEST(ShearModes, WhatIsNoLargerThanTheNoiseIsTakenOff) {
  Field f;
  for (size_t k = 0; k < f.where.size(); ++k) f.y[3 * k] = k % 2 == 0 ? kOne / 8 : -kOne / 8;  // no mode
  learned(f, kOne / 8).shrink(f.y, f.weight);
  double left = 0;
  for (size_t k = 0; k < f.where.size(); ++k) left += std::pow(static_cast<double>(f.y[3 * k]) * 8 / kOne, 2);
  EXPECT_LT(left, 0.05 * static_cast<double>(f.where.size()));  // but for what looks like a mode
}

TEST(ShearModes, WhatIsFarAboveTheNoiseIsKept) {
  Field f;
  for (size_t k = 0; k < f.where.size(); ++k) f.y[3 * k] = k % 2 == 0 ? kOne / 8 : -kOne / 8;
  learned(f, kOne / 800).shrink(f.y, f.weight);
  for (size_t k = 0; k < f.where.size(); ++k) {
    EXPECT_LT(std::abs(f.y[3 * k] - (k % 2 == 0 ? 1 : -1) * kOne / 8), kOne / 500) << k;
  }
}

TEST(ShearModes, PressureIsNotTouched) {
  Field f;
  for (size_t k = 0; k < f.where.size(); ++k) f.y[3 * k + 1] = static_cast<int64_t>(k * 977 % 401) * 100;
  const std::vector<int64_t> before = f.y;
  const ShearModes modes = learned(f, kOne);
  modes.shrink(f.y, f.weight);
  std::vector<int64_t> z(f.y.size());
  modes.precondition(f.y, z, 0);
  for (size_t k = 0; k < f.where.size(); ++k) {
    EXPECT_EQ(f.y[3 * k + 2], before[3 * k + 2]);
    EXPECT_EQ(z[3 * k + 2], 0);
  }
}

// M is symmetric and not negative: r . M s = s . M r, and what precondition() returns is r . M r.
TEST(ShearModes, ThePriorIsSymmetricAndItsEnergyIsRDotZ) {
  const Field f;
  const ShearModes modes = learned(f, 0);
  std::vector<int64_t> r(f.y.size());
  std::vector<int64_t> s(f.y.size());
  for (size_t i = 0; i < r.size(); ++i) {
    r[i] = static_cast<int64_t>(i * 7919 % 2003 - 1001) * 512;
    s[i] = static_cast<int64_t>(i * 104'729 % 1999 - 999) * 512;
  }
  std::vector<int64_t> m_r(r.size());
  std::vector<int64_t> m_s(r.size());
  constexpr int kShift = 4;
  const int64_t energy = modes.precondition(r, m_r, kShift);
  modes.precondition(s, m_s, kShift);
  const auto dot = [](const std::vector<int64_t>& a, const std::vector<int64_t>& b) {
    return std::inner_product(a.begin(), a.end(), b.begin(), 0.0, std::plus<>(),
                              [](int64_t x, int64_t y) { return static_cast<double>(x) * static_cast<double>(y); });
  };
  EXPECT_NEAR(dot(r, m_s) / dot(s, m_r), 1, 1e-4);
  EXPECT_GT(energy, 0);
  EXPECT_NEAR(static_cast<double>(energy) * std::ldexp(1, 2 * kShift) / dot(r, m_r), 1, 1e-4);
}

TEST(ShearModes, TwoContactsHaveTheirOwn) {
  Field f;
  for (int row = 0; row < kGrid.n_y; ++row) {
    const auto gap = static_cast<size_t>(row * kGrid.n_x + kGrid.n_x / 2);
    f.mask[gap] = 0;
  }
  f.index.clear();
  for (uint32_t node = 0; node < f.mask.size(); ++node) {
    if (f.mask[node] != 0) f.index.insert(f.index.end(), {3 * node, 3 * node + 1, 3 * node + 2});
  }
  std::vector<int64_t> y;
  for (size_t k = 0; 3 * k < f.index.size(); ++k) {
    const size_t node = f.index[3 * k] / 3;
    const auto pressure = static_cast<int64_t>(f.pressure(node) * kOne);
    y.insert(y.end(), {f.where[node].x_um < 0 ? -pressure / 2 : pressure / 2, 0, -pressure});  // pulled apart
  }
  const std::vector<int64_t> before = y;
  ShearModes modes(kGrid, f.where, kOne);
  modes.assign(f.mask, f.index);
  modes.learn(y, f.weight);
  modes.shrink(y, f.weight);
  for (size_t i = 0; i < y.size(); ++i) EXPECT_LT(std::abs(y[i] - before[i]), kOne / 1000) << i;
}

TEST(Components, NumbersInScanOrderAndTouchesAtCorners) {
  Components components({5, 3});
  const std::vector<uint8_t> mask = {1, 0, 0, 0, 9,  //
                                     0, 1, 0, 9, 0,  //
                                     0, 0, 0, 0, 9};
  const std::span<const uint16_t> label = components.find(mask);
  EXPECT_EQ(components.count(), 2);
  EXPECT_EQ(std::vector<uint16_t>(label.begin(), label.end()),
            (std::vector<uint16_t>{1, 0, 0, 0, 2, 0, 1, 0, 2, 0, 0, 0, 0, 0, 2}));
}

}  // namespace
}  // namespace ruffini
