#include "solve/node_sigma.h"

#include <gtest/gtest.h>

#include "base/filled.h"
#include "support/held_calibration.h"

namespace ruffini {
namespace {

constexpr GridSize kNodes{5, 4};
constexpr int64_t kThreshold = 300;

// Tables in units of the model: steps^2 and plain factors.
struct Tables {
  std::vector<int32_t> reported = std::vector<int32_t>(24, 1 << 8);
  std::vector<int32_t> quiet = std::vector<int32_t>(14, 1 << 8);
  std::vector<int32_t> local = std::vector<int32_t>(8, 0);
};

class Loaded {
 public:
  explicit Loaded(const Tables& tables) {
    file_ = test::held(test::CalibrationBytes()
                           .meta("kinds", "support")
                           .tensor("support.error_local", "I32", {2, 4}, tables.local)
                           .tensor("support.error_quiet", "I32", {2, 7}, tables.quiet)
                           .tensor("support.error_reported", "I32", {2, 12}, tables.reported));
  }
  [[nodiscard]] Result<NodeSigmaModel> model(int64_t stiffness_q20 = 0) const {
    return NodeSigmaModel::load(file_->get(), kNodes, kThreshold, stiffness_q20);
  }

 private:
  std::shared_ptr<const CalibrationFile> file_;
};

std::vector<NodeSigma> sigma_of(const Tables& tables, const std::vector<NodeForce>& force,
                                const std::vector<uint8_t>& is_filled = std::vector<uint8_t>(20)) {
  const Loaded loaded(tables);
  std::vector<NodeSigma> out(force.size());
  loaded.model().value().run(force, is_filled, out);
  return out;
}

std::vector<NodeForce> one_pressed(NodeForce middle) {
  std::vector<NodeForce> force(20);
  force[7] = middle;  // row 1, column 2
  return force;
}

TEST(FloorSqrt, IsExactAroundSquares) {
  EXPECT_EQ(floor_sqrt(0), 0);
  for (const int64_t root : {int64_t{1}, int64_t{2}, int64_t{3}, int64_t{1'000'003}, int64_t{1} << 30}) {
    EXPECT_EQ(floor_sqrt(root * root), root);
    EXPECT_EQ(floor_sqrt(root * root - 1), root - 1);
    EXPECT_EQ(floor_sqrt(root * root + 2 * root), root);
  }
}

TEST(NodeSigma, IsNeverZero) {
  for (const NodeSigma& s : sigma_of({}, std::vector<NodeForce>(20))) EXPECT_EQ(s.x + s.y + s.z, 3);
}

TEST(NodeSigma, GrowsWithTheForceAsTheStiffnessIsUncertain) {
  const Loaded loaded(Tables{});
  std::vector<NodeSigma> sigma(20);
  loaded.model(1 << 18).value().run(one_pressed({400, 0, -800}), std::vector<uint8_t>(20), sigma);  // a quarter
  EXPECT_EQ(sigma[7].x, 100);
  EXPECT_EQ(sigma[7].y, 1);
  EXPECT_EQ(sigma[7].z, 200);
  EXPECT_EQ(sigma[8].x, 1);
}

TEST(NodeSigma, TakesTheLevelOfThePressureAndOfWhatIsBesideAQuietNode) {
  Tables tables;
  tables.reported[7] = 100 << 8;       // shear, bit width 8
  tables.reported[12 + 7] = 400 << 8;  // normal
  tables.quiet[4] = 9 << 8;            // shear beside a pressure of bit width 7 or 8
  const auto sigma = sigma_of(tables, one_pressed({0, 0, -150}));
  EXPECT_EQ(sigma[7].x, 10);
  EXPECT_EQ(sigma[7].y, 10);
  EXPECT_EQ(sigma[7].z, 20);
  for (const size_t beside : {1U, 2U, 3U, 6U, 8U, 11U, 12U, 13U}) EXPECT_EQ(sigma[beside].x, 3) << beside;
  EXPECT_EQ(sigma[0].x, 1);
  EXPECT_EQ(sigma[16].x, 1);
}

TEST(NodeSigma, AddsReadingContrastAndStepInSquares) {
  Tables tables;
  tables.local = {1 << 14, 0, 0, 0, 0, 0, 0, 0};  // a quarter of the square: half the reading
  EXPECT_EQ(sigma_of(tables, one_pressed({800, -600, -600}))[7].x, 400);
  EXPECT_EQ(sigma_of(tables, one_pressed({800, -600, -600}))[7].y, 300);
  tables.local = {0, 1 << 16, 0, 0, 0, 0, 0, 0};  // alone among zeros, the whole force is contrast
  EXPECT_EQ(sigma_of(tables, one_pressed({800, 0, -600}))[7].x, 800);
  EXPECT_EQ(sigma_of(tables, one_pressed({800, 0, -150}))[7].x, 566);  // half the weight: 800 / sqrt(2)
  EXPECT_EQ(sigma_of(tables, one_pressed({800, 0, 600}))[7].x, 1);     // a node that pulls has none
  tables.local = {0, 0, 0, 0, 0, 0, 1 << 16, 0};
  std::vector<NodeForce> force = one_pressed({0, 0, -600});
  for (NodeForce& f : force) f.z -= 400;
  EXPECT_EQ(sigma_of(tables, force)[7].z, 600);
  tables.local = {0, 0, 1 << 16, 0, 0, 0, 0, 0};  // a node without force, too, may hide what its neighbours carry
  EXPECT_EQ(sigma_of(tables, one_pressed({800, 0, -600}))[6].x, 800);
  EXPECT_EQ(sigma_of(tables, one_pressed({800, 0, -600}))[5].x, 1);
}

TEST(NodeSigma, AddsTheRoughnessOfThePressureAround) {
  Tables tables;
  tables.local = {0, 0, 0, 1 << 16, 0, 0, 0, 0};
  std::vector<NodeForce> force(20);
  force[7].z = force[9].z = -800;  // row 1, columns 2 and 4: each in the other's square
  const auto sigma = sigma_of(tables, force);
  // d_z^2: 800^2 at both, (800 / 8)^2 at the ten other nodes beside one of them, three of which lie between and have
  // (2 x 800 / 8)^2: (2 x 640,000 + 7 x 10,000 + 3 x 40,000) / 64 is 151.5^2.
  EXPECT_EQ(sigma[7].x, 152);
  EXPECT_EQ(sigma[9].x, 152);
  EXPECT_EQ(sigma[8].x, 1);  // nothing presses there
}

TEST(NodeSigma, FilledComponentsStateMore) {
  Tables tables;
  tables.local = {1 << 14, 0, 0, 0, 1 << 14, 0, 0, 0};
  const std::vector<NodeForce> force = one_pressed({800, -600, -600});
  std::vector<uint8_t> is_filled(20);
  is_filled[7] = kShearFilled;  // the pressed one
  is_filled[9] = kAllFilled;
  const auto whole = sigma_of(tables, force);
  const auto filled = sigma_of(tables, force, is_filled);
  // Five nodes to a row. Halves of the sigma of measured nodes: along the surface, then of the normal force.
  const std::vector<int32_t> shear = {2, 3, 3, 3, 3, 2, 3, 5, 3, 5, 2, 3, 3, 3, 3, 2, 2, 2, 2, 2};
  const std::vector<int32_t> normal = {2, 2, 2, 3, 3, 2, 2, 2, 3, 8, 2, 2, 2, 3, 3, 2, 2, 2, 2, 2};
  const auto grown = [](int32_t sigma, int32_t halves) { return (sigma * halves + 1) / 2; };
  for (size_t i = 0; i < filled.size(); ++i) {
    EXPECT_EQ(filled[i].x, grown(whole[i].x, shear[i])) << i;
    EXPECT_EQ(filled[i].y, grown(whole[i].y, shear[i])) << i;
    EXPECT_EQ(filled[i].z, grown(whole[i].z, normal[i])) << i;
  }
  EXPECT_EQ(filled[7].x, 1'000);
}

TEST(NodeSigma, LargestForcesAndTablesDoNotOverflow) {
  Tables tables;
  tables.reported.assign(24, INT32_MAX);
  tables.local.assign(8, NodeSigmaModel::kMaxFactor);
  std::vector<NodeForce> force(20);
  for (size_t i = 0; i < force.size(); ++i) {
    const int32_t f = i % 2 == 0 ? INT32_MIN : INT32_MAX;
    force[i] = {f, f, INT32_MIN};
  }
  // (4 (1 + contrast^2 + step^2 + rough^2))^(1/2) of 2^20 steps, no term above 2 of them: below 2 * 4 * 2^20.
  for (const NodeSigma& s : sigma_of(tables, force)) {
    EXPECT_GT(s.x, 2 << 20);
    EXPECT_LT(s.x, 8 << 20);
  }
}

TEST(NodeSigma, RefusesTablesThatStateNoError) {
  Tables tables;
  tables.quiet[3] = 255;
  EXPECT_FALSE(Loaded(tables).model());
  tables = {};
  tables.local[1] = NodeSigmaModel::kMaxFactor + 1;
  EXPECT_FALSE(Loaded(tables).model());
  tables.local[1] = NodeSigmaModel::kMaxFactor;
  EXPECT_TRUE(Loaded(tables).model());
}

}  // namespace
}  // namespace ruffini
