#include "solve/contact_mask.h"

#include <gtest/gtest.h>

#include <string>

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
  EXPECT_EQ(mask_of(std::string(35, '+'), 1), nothing);
  EXPECT_EQ(mask_of(std::string(35, '^'), 1), nothing);
  EXPECT_EQ(mask_of(std::string(35, '#'), 35), std::string(35, '#'));
}

TEST(ContactMask, RisesFromTheThresholdToTwiceTheThreshold) {
  ContactMask stage(kNodes, 300, 1);
  const auto value_at = [&](int32_t z) { return int{stage.find(std::vector<NodeForce>(35, {0, 0, z}))[17]}; };
  EXPECT_EQ(value_at(-300), 0);
  EXPECT_EQ(value_at(-301), 1);
  EXPECT_EQ(value_at(-450), 64);
  EXPECT_EQ(value_at(-600), 128);
  EXPECT_EQ(value_at(-2'000'000'000), 128);
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

}  // namespace
}  // namespace ruffini
