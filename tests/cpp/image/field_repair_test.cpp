#include "image/field_repair.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace ruffini {
namespace {

constexpr GridSize kSize{19, 15};
constexpr int32_t kLeast = 500;  // 62.5 um
constexpr int32_t kOff = 1'600;  // 200 um

// A dent's shear, 1/8 um: up to 150 um towards its middle.
std::vector<FieldValue> dent() {
  std::vector<FieldValue> out;
  for (int y = 0; y < kSize.n_y; ++y) {
    for (int x = 0; x < kSize.n_x; ++x) {
      const double u = (x - 8.3) / 3, v = (y - 7.1) / 3, size = 2'000 * std::exp(-(u * u + v * v) / 2);
      out.push_back({static_cast<int32_t>(std::lround(-u * size)), static_cast<int32_t>(std::lround(-v * size))});
    }
  }
  return out;
}

double off(const FieldValue& a, const FieldValue& b) { return std::hypot(a.x - b.x, a.y - b.y); }

TEST(FieldRepair, ASmoothFieldStaysBitForBit) {
  FieldRepair repair(kSize);
  std::vector<FieldValue> field = dent();
  std::vector<uint8_t> missing(field.size());
  EXPECT_EQ(repair.run(field, missing, kLeast), 0);
  const std::vector<FieldValue> before = dent();
  for (size_t i = 0; i < field.size(); ++i) EXPECT_EQ(off(field[i], before[i]), 0) << i;
}

TEST(FieldRepair, EightOutliersAreFoundAndFilledWithinAFewMicrometres) {
  std::mt19937 random(7);
  const std::vector<FieldValue> truth = dent();
  FieldRepair repair(kSize);
  for (int round = 0; round < 20; ++round) {
    std::vector<FieldValue> field = truth;
    std::vector<uint8_t> missing(field.size()), is_wrong(field.size());
    for (int k = 0; k < 8; ++k) {
      // One in each of 4 x 2 blocks inside the border, so none side by side.
      const int x = 3 + 4 * (k % 4) + static_cast<int>(random() % 2);
      const int y = 3 + 6 * (k / 4) + static_cast<int>(random() % 3);
      const auto at = static_cast<size_t>(y * kSize.n_x + x);
      const double angle = static_cast<double>(random() % 628) / 100;
      field[at].x += static_cast<int32_t>(kOff * std::cos(angle));
      field[at].y += static_cast<int32_t>(kOff * std::sin(angle));
      is_wrong[at] = 1;
    }
    EXPECT_EQ(repair.run(field, missing, kLeast), 8);
    for (size_t i = 0; i < field.size(); ++i) {
      EXPECT_EQ(missing[i] == FieldRepair::kOutlier, is_wrong[i] != 0) << i;
      EXPECT_LT(off(field[i], truth[i]), is_wrong[i] != 0 ? 100 : 1) << i;  // 12 um of 200
    }
  }
}

// A flat punch, its shear held inside and gone outside; 1/8 um.
std::vector<FieldValue> edge(double radius) {
  std::vector<FieldValue> out;
  for (int y = 0; y < kSize.n_y; ++y) {
    for (int x = 0; x < kSize.n_x; ++x) {
      const double far = std::hypot(x - 9.2, y - 6.9);
      const double held = far < radius ? 1 : std::exp(-(far - radius));
      out.push_back(
          {static_cast<int32_t>(1'200 * held), static_cast<int32_t>(-600 * held), static_cast<int32_t>(-4'000 * held)});
    }
  }
  return out;
}

TEST(FieldRepair, TheEdgeOfAContactIsNoOutlier) {
  for (double radius = 0.5; radius < 5; radius += 0.1) {  // of half a pitch and more
    std::vector<FieldValue> field = edge(radius);
    std::vector<uint8_t> missing(field.size());
    EXPECT_EQ(FieldRepair(kSize).run(field, missing, kLeast), 0) << radius;
  }
}

TEST(FieldRepair, DepthIsAnOutlierAtFourTimesThat) {
  for (const int32_t off : {1'600, 3'200}) {  // 200 and 400 um; gate 250
    std::vector<FieldValue> field = dent();
    std::vector<uint8_t> missing(field.size());
    field[7 * kSize.n_x + 12].z -= off;
    EXPECT_EQ(FieldRepair(kSize).run(field, missing, kLeast), off > 4 * kLeast ? 1 : 0);
  }
}

TEST(FieldRepair, AHoleOfThreeLinesIsFilledAsTheFieldBends) {
  const std::vector<FieldValue> truth = dent();
  std::vector<FieldValue> field = truth;
  std::vector<uint8_t> missing(field.size());
  for (int y = 5; y < 8; ++y) {
    for (int x = 7; x < 10; ++x) {
      field[static_cast<size_t>(y * kSize.n_x + x)] = {};
      missing[static_cast<size_t>(y * kSize.n_x + x)] = 1;
    }
  }
  EXPECT_EQ(FieldRepair(kSize).run(field, missing, kLeast), 0);
  for (size_t i = 0; i < field.size(); ++i) EXPECT_LT(off(field[i], truth[i]), missing[i] != 0 ? 200 : 1) << i;
}

TEST(FieldRepair, ALatticeTooCoarseForAContactHasNoOutliers) {
  EXPECT_EQ(FieldRepair::least_q3(1'000, 1'000, 4'000), 8 * 1'000 / 16) << "a sixteenth of the pitch";
  EXPECT_EQ(FieldRepair::least_q3(100, 100, 4'000), 8 * 30) << "but 30 um at least";
  EXPECT_EQ(FieldRepair::least_q3(1'000, 1'500, 4'000), 8 * 1'000 / 16) << "the pitch may be 3/8 of the thickness";
  EXPECT_EQ(FieldRepair::least_q3(1'000, 1'501, 4'000), FieldRepair::kNoOutliers);
  // The largest value there is, alone in an untouched field: a contact on one marker.
  std::vector<FieldValue> field(dent().size());
  std::vector<uint8_t> missing(field.size());
  field[7 * kSize.n_x + 12].x = FieldRepair::kMaxInput;
  EXPECT_EQ(FieldRepair(kSize).run(field, missing, FieldRepair::kNoOutliers), 0);
  EXPECT_EQ(FieldRepair(kSize).run(field, missing, kLeast), 1);
}

TEST(FieldRepair, WithNothingKnownTheFieldStays) {
  std::vector<FieldValue> field(dent().size(), {3, -4});
  std::vector<uint8_t> missing(field.size(), 1);
  EXPECT_EQ(FieldRepair(kSize).run(field, missing, kLeast), 0);
  EXPECT_EQ(field.back().y, -4);
}

}  // namespace
}  // namespace ruffini
