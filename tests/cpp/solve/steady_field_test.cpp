#include "solve/steady_field.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

namespace ruffini {
namespace {

constexpr GridSize kNodes{.n_x = 9, .n_y = 7};
constexpr int kFrames = 8;
constexpr double kNoise = 30;      // force steps
constexpr double kUnit = 1 << 14;  // one standard deviation of the evidence

std::vector<NodePlace> places() {
  std::vector<NodePlace> out;
  for (int y = 0; y < kNodes.n_y; ++y) {
    for (int x = 0; x < kNodes.n_x; ++x) out.push_back({600 * x - 2'400, 700 * y - 2'100});
  }
  return out;
}

struct Frame {
  std::vector<uint8_t> mask;
  std::vector<int64_t> evidence;
  std::vector<NodeForce> force;
};

// A contact of 5 x 4 nodes from column `first` on, with a force that grows with `load`, and noise.
class Pad {
 public:
  Frame frame(int first, double load, double noise = 1) {
    Frame out;
    for (int y = 0; y < kNodes.n_y; ++y) {
      for (int x = 0; x < kNodes.n_x; ++x) {
        const bool is_touched = x >= first && x < first + 5 && y >= 2 && y < 6;
        out.mask.push_back(is_touched ? 128 : 0);
        out.force.emplace_back();
        if (!is_touched) continue;
        const double shape = 1 + 0.2 * (x - first) + 0.1 * y;
        const std::array<double, 3> part = {0.3 * shape, -0.1 * shape, -shape};
        std::array<int32_t, 3> f{};
        for (size_t a = 0; a < 3; ++a) {
          f[a] = static_cast<int32_t>(std::lround(load * part[a] + noise * kNoise * normal_(random_)));
          out.evidence.push_back(std::llround(kUnit * (0.1 * load * part[a] + noise * normal_(random_))));
        }
        out.force.back() = {f[0], f[1], f[2]};
      }
    }
    return out;
  }

 private:
  std::mt19937 random_{7};
  std::normal_distribution<double> normal_;
};

// Force and moments, in steps and steps times mm.
std::array<double, 6> wrench(const std::vector<NodeForce>& force) {
  std::array<double, 6> w{};
  const std::vector<NodePlace> at = places();
  for (size_t i = 0; i < force.size(); ++i) {
    const double x = at[i].x_um * 1e-3;
    const double y = at[i].y_um * 1e-3;
    const NodeForce& f = force[i];
    const std::array<double, 6> part = {1.0 * f.x, 1.0 * f.y, 1.0 * f.z, y * f.z, -x * f.z, x * f.y - y * f.x};
    for (size_t k = 0; k < 6; ++k) w[k] += part[k];
  }
  return w;
}

class Steady : public ::testing::Test {
 protected:
  std::vector<NodeForce> averaged(const Frame& frame) {
    std::vector<NodeForce> force = frame.force;
    field_.run(frame.mask, frame.evidence, force, saturations_);
    EXPECT_EQ(saturations_.count, 0U);
    return force;
  }
  void hold(int frames) {
    for (int i = 0; i < frames; ++i) averaged(pad_.frame(2, 1'000));
  }
  [[nodiscard]] int frames_averaged() const { return field_.frames_at(4 * 9 + 4); }

  Pad pad_;
  SteadyField field_{kNodes, places(), kFrames};
  SaturationCounter saturations_;
};

TEST_F(Steady, ForceAndMomentsAreThoseOfEachFrameWhileTheFieldIsAveraged) {
  hold(kFrames);
  bool has_changed = false;
  for (int i = 0; i < 50; ++i) {
    const Frame frame = pad_.frame(2, 1'000);
    const std::vector<NodeForce> force = averaged(frame);
    const std::array<double, 6> before = wrench(frame.force);
    const std::array<double, 6> after = wrench(force);
    for (size_t k = 0; k < 3; ++k) EXPECT_EQ(after[k], before[k]) << k;
    for (size_t k = 3; k < 6; ++k) EXPECT_NEAR(after[k], before[k], 15) << k;  // noise alone moves it by 200
    has_changed |= force[40].z != frame.force[40].z;
  }
  EXPECT_TRUE(has_changed);
}

TEST_F(Steady, NoiseOfAHeldContactFalls) {
  hold(kFrames);
  double before = 0;
  double after = 0;
  const Frame truth = pad_.frame(2, 1'000, 0);
  for (int i = 0; i < 200; ++i) {
    const Frame frame = pad_.frame(2, 1'000);
    const std::vector<NodeForce> force = averaged(frame);
    for (size_t k = 0; k < force.size(); ++k) {
      before += std::pow(frame.force[k].z - truth.force[k].z, 2) + std::pow(frame.force[k].x - truth.force[k].x, 2);
      after += std::pow(force[k].z - truth.force[k].z, 2) + std::pow(force[k].x - truth.force[k].x, 2);
    }
  }
  // 6 of 60 unknowns keep their noise; the others keep 1/15 of its square in the long run of 1/8.
  EXPECT_NEAR(std::sqrt(after / before), std::sqrt(0.15 + 0.85 / 15), 0.08);
}

// 1.5 % of the load raises the evidence by 1 to 3 standard deviations: no node's test shows it.
TEST_F(Steady, AStepTooSmallForTheTestAppearsInItsFrame) {
  hold(kFrames);
  const Frame before = pad_.frame(2, 1'000, 0);
  averaged(before);
  const Frame frame = pad_.frame(2, 1'015, 0);
  const std::vector<NodeForce> force = averaged(frame);
  EXPECT_EQ(frames_averaged(), kFrames);
  const std::vector<NodeForce> held = averaged(before);
  const auto step = [](const std::vector<NodeForce>& a, const std::vector<NodeForce>& b) {
    std::array<double, 6> w = wrench(a);
    const std::array<double, 6> other = wrench(b);
    for (size_t k = 0; k < 6; ++k) w[k] -= other[k];
    return w;
  };
  const std::array<double, 6> seen = step(force, held);
  const std::array<double, 6> true_step = step(frame.force, before.force);
  for (size_t k = 0; k < 3; ++k) EXPECT_EQ(seen[k], true_step[k]);
  // and node by node: a field that grows as a whole is no change of its shape
  for (size_t k = 0; k < force.size(); ++k) {
    EXPECT_NEAR(force[k].z - held[k].z, frame.force[k].z - before.force[k].z, 3) << k;
    EXPECT_NEAR(force[k].x - held[k].x, frame.force[k].x - before.force[k].x, 3) << k;
  }
}

TEST_F(Steady, AStepIsTakenWhole) {
  for (const double load : {1'050.0, 1'100.0, 1'300.0, 2'000.0, 500.0}) {
    hold(kFrames);
    const Frame frame = pad_.frame(2, load);
    const std::vector<NodeForce> force = averaged(frame);
    EXPECT_EQ(frames_averaged(), 1) << load;
    for (size_t k = 0; k < force.size(); ++k) {
      EXPECT_EQ(force[k].x, frame.force[k].x) << load;
      EXPECT_EQ(force[k].z, frame.force[k].z) << load;
    }
  }
}

// At one node the evidence changes by seven standard deviations: a slip of a part of the contact.
TEST_F(Steady, AChangeAtOneNodeIsTakenWhole) {
  hold(kFrames);
  Frame frame = pad_.frame(2, 1'000);
  frame.evidence[3 * 7] += static_cast<int64_t>(7 * kUnit);
  const std::vector<NodeForce> force = averaged(frame);
  EXPECT_EQ(frames_averaged(), 1);
  for (size_t k = 0; k < force.size(); ++k) EXPECT_EQ(force[k].y, frame.force[k].y);
}

// Also if the evidence at the nodes that stay touched shows nothing: 3 of 5 columns are too few.
TEST_F(Steady, AContactThatMovesOnIsNotAveraged) {
  for (int i = 0; i < kFrames; ++i) {
    Frame still = pad_.frame(2, 1'000);
    std::fill(still.evidence.begin(), still.evidence.end(), 0);
    averaged(still);
  }
  EXPECT_EQ(frames_averaged(), kFrames);
  Frame frame = pad_.frame(4, 1'000);
  std::fill(frame.evidence.begin(), frame.evidence.end(), 0);
  const std::vector<NodeForce> force = averaged(frame);
  EXPECT_EQ(frames_averaged(), 1);
  for (size_t k = 0; k < force.size(); ++k) EXPECT_EQ(force[k].z, frame.force[k].z);
}

TEST_F(Steady, AContactThatWasLostBeginsAnew) {
  hold(kFrames);
  Frame none = pad_.frame(20, 0);
  averaged(none);
  averaged(pad_.frame(2, 1'000));
  EXPECT_EQ(frames_averaged(), 1);
  hold(3);
  field_.forget();
  averaged(pad_.frame(2, 1'000));
  EXPECT_EQ(frames_averaged(), 1);
}

TEST_F(Steady, LargestForcesDoNotOverflow) {
  Frame frame = pad_.frame(2, 1'000);
  for (int i = 0; i < 4; ++i) {
    for (NodeForce& f : frame.force) {
      if (f.z == 0) continue;
      f = {INT32_MAX - i, INT32_MIN + i, INT32_MIN + 60'000 * i};
    }
    for (int64_t& b : frame.evidence) b = INT64_MAX;
    std::vector<NodeForce> force = frame.force;
    field_.run(frame.mask, frame.evidence, force, saturations_);
    EXPECT_EQ(wrench(force)[0], wrench(frame.force)[0]);
  }
}

}  // namespace
}  // namespace ruffini
