#include "solve/contact_mask.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <string>

#include "support/held_calibration.h"

namespace ruffini {
namespace {

constexpr GridSize kNodes{7, 5};

// '#' presses with -301 steps, '+' with -300 (the threshold itself), '^' pulls.
std::string mask_of(const std::string& picture, int64_t min_nodes) {
  std::vector<NodeForce> force;
  for (const char c : picture)
    force.push_back({1'000'000, 0, c == '#' ? -301 : c == '+' ? -300 : c == '^' ? 9'000 : 0});
  ContactMask stage(kNodes, 300, min_nodes);
  std::string out;
  for (const uint8_t touched : stage.find(force)) out += touched != 0 ? '#' : '.';
  return out;
}

TEST(ContactMask, OpensByTwoAndGrowsByOne) {
  EXPECT_EQ(mask_of("......."
                    "..##..."
                    "..##..#"
                    "......."
                    "#######",
                    4),
            ".####.."
            ".####.."
            ".####.."
            ".####.."
            ".......");
}

TEST(ContactMask, NeedsMoreThanTheThresholdAndPressure) {
  const std::string nothing(35, '.');
  EXPECT_EQ(mask_of("+++++++"
                    "+++++++"
                    "+++++++"
                    "......."
                    "+++++++",
                    1),
            nothing);
  EXPECT_EQ(mask_of(std::string(35, '^'), 1), nothing);
  EXPECT_EQ(mask_of(std::string(35, '#'), 35), std::string(35, '#'));
}

TEST(ContactMask, RisesFromTheThresholdToTwiceTheThreshold) {
  ContactMask stage(kNodes, 300, 1);
  const auto value_at = [&](int32_t z) {
    std::vector<NodeForce> force(35);
    for (const size_t i : {16U, 17U, 23U, 24U}) force[i].z = z;
    return int{stage.find(force)[17]};
  };
  EXPECT_EQ(value_at(-300), 0);
  EXPECT_EQ(value_at(-301), 1);
  EXPECT_EQ(value_at(-450), 64);
  EXPECT_EQ(value_at(-600), 128);
  EXPECT_EQ(value_at(-2'000'000'000), 128);
}

// A square of 4 x 4 nodes by a quarter of the threshold, one of 8 x 8 by a sixteenth.
TEST(ContactMask, AWidePressureCountsWhereANarrowOneDoesNot) {
  constexpr GridSize kWide{12, 11};
  ContactMask stage(kWide, 320, 4);
  const auto value_of = [&](int side, int32_t z) {
    std::vector<NodeForce> force(static_cast<size_t>(kWide.count()));
    for (int y = 2; y < 2 + side; ++y) {
      for (int x = 3; x < 3 + side; ++x) force[static_cast<size_t>(y * kWide.n_x + x)].z = z;
    }
    const std::span<const uint8_t> mask = stage.find(force);
    const auto n = std::count_if(mask.begin(), mask.end(), [](uint8_t m) { return m != 0; });
    EXPECT_TRUE(n == 0 || n == (side + 2) * (side + 2)) << n;
    return int{mask[static_cast<size_t>(3 * kWide.n_x + 4)]};
  };
  EXPECT_EQ(value_of(3, -320), 0);
  EXPECT_EQ(value_of(4, -80), 0);
  EXPECT_EQ(value_of(4, -120), 64);
  EXPECT_EQ(value_of(7, -79), 0);
  EXPECT_EQ(value_of(8, -20), 0);
  EXPECT_EQ(value_of(8, -30), 64);
  EXPECT_EQ(stage.threshold_lsb(), 20);
  EXPECT_FALSE(stage.is_pressed());
  EXPECT_EQ(value_of(1, -80), 0);
  EXPECT_FALSE(stage.is_pressed());
  EXPECT_EQ(value_of(1, -81), 0);
  EXPECT_TRUE(stage.is_pressed()) << "a quarter of the threshold is 80";
}

TEST(ContactMask, AStrongNodeHidesWhatIsFaintBesideIt) {
  constexpr GridSize kWide{12, 10};
  ContactMask stage(kWide, 320, 4);
  std::vector<NodeForce> force(static_cast<size_t>(kWide.count()), NodeForce{0, 0, -60});
  EXPECT_EQ(int{stage.find(force)[0]}, 128);
  force[60].z = -480;  // an eighth: 60
  EXPECT_EQ(int{stage.find(force)[0]}, 0);
}

TEST(ContactMask, TheWeakestOfASquareCounts) {
  std::vector<NodeForce> force(35);
  for (const size_t i : {0U, 1U, 7U}) force[i].z = -600;
  force[8].z = -375;
  ContactMask stage(kNodes, 300, 1);
  EXPECT_EQ(int{stage.find(force)[0]}, 32);
}

TEST(ContactMask, IsEmptyBelowTheLeastNumberOfNodes) {
  EXPECT_EQ(mask_of("##....."
                    "##....."
                    "......."
                    "......."
                    ".......",
                    5),
            std::string(35, '.'));
  EXPECT_EQ(mask_of("##....."
                    "##....."
                    "......."
                    "......."
                    ".......",
                    4),
            "###...."
            "###...."
            "###...."
            "......."
            ".......");
}

// A file with kind `contact`, in uN; steps of 10 uN.
class Noise {
 public:
  Noise(int32_t of_four_un, int32_t alone_un) {
    file_ = test::held(test::CalibrationBytes()
                           .meta("kinds", "contact")
                           .tensor("contact.noise_un", "I32", {2}, std::vector<int32_t>{of_four_un, alone_un}));
  }
  [[nodiscard]] Status into(ContactMask& stage) const { return stage.load_noise(file_->get(), 10); }

 private:
  std::shared_ptr<const CalibrationFile> file_;
};

TEST(ContactMask, SeesWhatTheNoiseOfTheUnitAllows) {
  ContactMask stage(kNodes, 300, 4);
  ASSERT_TRUE(Noise(500, 700).into(stage).has_value());  // 50 and 70 steps
  std::vector<NodeForce> force(35);
  const auto touch = [&](int32_t four, int32_t other) {
    for (const size_t i : {8U, 9U, 15U, 16U}) force[i].z = -four;
    force[33].z = -other;
    const std::span<const uint8_t> mask = stage.find(force);
    return std::pair{int{mask[8]}, int{mask[33]}};
  };
  EXPECT_EQ(touch(50, 0), (std::pair{0, 0}));
  EXPECT_EQ(touch(75, 0), (std::pair{64, 0}));  // beyond 50 by half of it
  EXPECT_EQ(touch(0, 70), (std::pair{0, 0}));   // one node: beyond 70
  EXPECT_EQ(touch(0, 105), (std::pair{0, 64}));
  EXPECT_EQ(touch(90, 800), (std::pair{0, 128}));  // beside a strong one: an eighth of it
  EXPECT_EQ(stage.threshold_lsb(), 100);
  touch(75, 0);
  EXPECT_EQ(int{stage.find(force, false)[8]}, 0);  // while the light drifts: the board's threshold
  EXPECT_EQ(stage.threshold_lsb(), 300);
  EXPECT_EQ(touch(450, 8'000), (std::pair{64, 128}));  // never more than the board's threshold
  EXPECT_EQ(stage.threshold_lsb(), 300);
}

TEST(ContactMask, NoiseBeyondTheBoardsThresholdRaisesIt) {
  ContactMask stage(kNodes, 300, 4);
  ASSERT_TRUE(Noise(4'000, 5'000).into(stage).has_value());
  EXPECT_EQ(int{stage.find(std::vector<NodeForce>(35, {0, 0, -400}))[17]}, 0);
  EXPECT_EQ(int{stage.find(std::vector<NodeForce>(35, {0, 0, -500}))[17]}, 32);
}

TEST(ContactMask, RefusesNoiseThatIsNone) {
  ContactMask stage(kNodes, 300, 4);
  for (const int32_t wrong : {0, -5, 100'000'001}) {
    const Status loaded = Noise(wrong, 700).into(stage);
    ASSERT_FALSE(loaded.has_value());
    EXPECT_NE(loaded.error().message.find("contact.noise_un"), std::string::npos);
  }
}

}  // namespace
}  // namespace ruffini
