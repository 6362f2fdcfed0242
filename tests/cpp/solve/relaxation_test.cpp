#include "solve/relaxation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <tuple>

#include "support/held_calibration.h"

namespace ruffini {
namespace {

constexpr uint64_t kFrameUs = 10'000;
constexpr uint8_t kTouched = 128;

class Loaded {
 public:
  Loaded(const std::vector<int32_t>& parts, const std::vector<int32_t>& times_ms, const std::string& n_terms) {
    const auto n = static_cast<int>(parts.size());
    file_ = test::held(test::CalibrationBytes()
                           .meta("kinds", "relaxation")
                           .meta("relaxation.terms", n_terms)
                           .tensor("relaxation.part", "I32", {n}, parts)
                           .tensor("relaxation.time_ms", "I32", {n}, times_ms));
  }
  [[nodiscard]] Result<Relaxation> relaxation(int n_nodes) const { return Relaxation::load(file_->get(), n_nodes); }

 private:
  std::shared_ptr<const CalibrationFile> file_;
};

int32_t part(double share) { return static_cast<int32_t>(std::lround(share * (1 << 20))); }

TEST(Relaxation, ThePartOfAStepIsExponential) {
  for (const int64_t time_us : {1'000, 100'000, 7'000'000, 1'000'000'000}) {
    for (const uint64_t duration_us : {0U, 1U, 999U, 16'667U, 250'000U, 3'000'000U, 4'000'000'000U}) {
      const double expected = -std::expm1(-static_cast<double>(duration_us) / static_cast<double>(time_us));
      EXPECT_NEAR(static_cast<double>(relaxed_part_q20(duration_us, time_us)), expected * (1 << 20), 1)
          << duration_us << " of " << time_us;
    }
  }
}

// Held from the first frame on: f = f_e (1 - sum g (1 - exp(-t / tau))).
TEST(Relaxation, AHeldStrainLosesItsForceAsTheSeriesSays) {
  const Loaded loaded({part(0.1), part(0.2)}, {50, 400}, "2");
  Relaxation pad = loaded.relaxation(1).value();
  SaturationCounter saturations;
  std::vector<NodeForce> force(1);
  const std::vector<uint8_t> mask = {kTouched};
  pad.run(1, mask, force, saturations);  // untouched
  for (int i = 1; i <= 200; ++i) {
    force[0] = {30'000, -20'000, -100'000};
    pad.run(1 + static_cast<uint64_t>(i) * kFrameUs, mask, force, saturations);
    const double t = (i - 0.5) * kFrameUs * 1e-6;  // the force came in within the first step
    const double left = 1 + 0.1 * std::expm1(-t / 0.05) + 0.2 * std::expm1(-t / 0.4);
    EXPECT_NEAR(force[0].z, -100'000 * left, 100) << i;
    EXPECT_NEAR(force[0].x, 30'000 * left, 30) << i;
    EXPECT_NEAR(force[0].y, -20'000 * left, 20) << i;
  }
  EXPECT_EQ(saturations.count, 0U);
}

TEST(Relaxation, AfterItLetsGoThereIsNoForceAndTheDentGoes) {
  const Loaded loaded({part(0.3)}, {100}, "1");
  Relaxation pad = loaded.relaxation(1).value();
  SaturationCounter saturations;
  std::vector<NodeForce> force(1);
  uint64_t now = 1;
  const auto frame = [&](uint8_t mask, int32_t f) {
    force[0] = {0, 0, f};
    pad.run(now += kFrameUs, std::vector<uint8_t>{mask}, force, saturations);
    return force[0].z;
  };
  for (int i = 0; i < 100; ++i) frame(kTouched, -10'000);
  EXPECT_EQ(frame(0, 0), 0);
  // Touched again at once, the elastic force comes on a dent: less than on a rested pad.
  Relaxation rested = loaded.relaxation(1).value();
  std::vector<NodeForce> first = {{0, 0, -10'000}};
  rested.run(1, std::vector<uint8_t>{kTouched}, first, saturations);
  EXPECT_GT(frame(kTouched, -10'000), first[0].z + 1'000);
  for (int i = 0; i < 300; ++i) EXPECT_EQ(frame(0, 0), 0);
  EXPECT_NEAR(frame(kTouched, -10'000), -10'000, 200);
}

TEST(Relaxation, ItForgetsAndTimeDoesNotRunBackwards) {
  const Loaded loaded({part(0.5)}, {10}, "1");
  Relaxation pad = loaded.relaxation(1).value();
  SaturationCounter saturations;
  std::vector<NodeForce> force = {{0, 0, -1'000}};
  pad.run(1'000'000, std::vector<uint8_t>{kTouched}, force, saturations);
  force[0] = {0, 0, -1'000};
  pad.run(500, std::vector<uint8_t>{kTouched}, force, saturations);
  EXPECT_EQ(force[0].z, -1'000);
  force[0] = {0, 0, -1'000};
  pad.run(2'000'000, std::vector<uint8_t>{kTouched}, force, saturations);
  EXPECT_NEAR(force[0].z, -500, 1);
  pad.forget();
  force[0] = {0, 0, -1'000};
  pad.run(3'000'000, std::vector<uint8_t>{kTouched}, force, saturations);
  EXPECT_EQ(force[0].z, -1'000);
}

TEST(Relaxation, AnImpossibleForceIsHeldAndCounted) {
  const Loaded loaded({part(0.5)}, {10}, "1");
  Relaxation pad = loaded.relaxation(1).value();
  SaturationCounter saturations;
  std::vector<NodeForce> force = {{INT32_MAX, INT32_MIN, 0}};
  for (uint64_t i = 1; i < 50; ++i) {
    force[0] = {INT32_MAX, INT32_MIN, 0};
    pad.run(i * kFrameUs, std::vector<uint8_t>{kTouched}, force, saturations);
  }
  EXPECT_EQ(saturations.count, 98U);
  EXPECT_NEAR(force[0].x, 1 << 24, 1 << 10);
}

TEST(Relaxation, RefusesWhatNoRubberDoes) {
  for (const auto& [parts, times, n] : std::vector<std::tuple<std::vector<int32_t>, std::vector<int32_t>, std::string>>{
           {{part(-0.1)}, {100}, "1"},
           {{part(0.6), part(0.5)}, {100, 200}, "2"},
           {{part(0.5), part(0.5)}, {100, 200}, "2"},
           {{part(0.1)}, {0}, "1"},
           {{part(0.1)}, {1'000'001}, "1"},
           {{part(0.1)}, {100}, "2"},
           {{part(0.1)}, {100}, "0"},
           {{part(0.1)}, {100}, "5"}}) {
    const auto refused = Loaded(parts, times, n).relaxation(3);
    ASSERT_FALSE(refused.has_value());
    EXPECT_NE(refused.error().message.find("relax"), std::string::npos) << refused.error().message;
  }
}

// A dent without a load goes at (1 - g) / tau, more slowly than at 1 / tau: what is gone of it adds to what is still to
// go.
TEST(Relaxation, ADentGoesAsSlowlyAsItsOwnPartLets) {
  const Loaded loaded({part(0.3)}, {100}, "1");
  Relaxation pad = loaded.relaxation(1).value();
  SaturationCounter saturations;
  std::vector<NodeForce> force(1);
  uint64_t now = 1;
  const auto frame = [&](uint8_t mask, int32_t f) {
    force[0] = {0, 0, f};
    pad.run(now += kFrameUs, std::vector<uint8_t>{mask}, force, saturations);
    return force[0].z;
  };
  for (int i = 0; i < 200; ++i) frame(kTouched, -10'000);
  for (int i = 0; i < 10; ++i) frame(0, 0);
  const double dent = std::exp(-0.7 * (9.5 * 0.01) / 0.1);  // it was let go within the first step
  const double pressed = dent + ((1 + 0.3 * dent) / 2 - dent) * -std::expm1(-0.1);
  EXPECT_NEAR(frame(kTouched, -10'000), -10'000 * (1 - 0.3 * pressed), 60);
}

}  // namespace
}  // namespace ruffini
