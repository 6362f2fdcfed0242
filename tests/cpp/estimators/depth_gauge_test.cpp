#include "estimators/depth_gauge.h"

#include <gtest/gtest.h>

#include "support/held_calibration.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

constexpr size_t kNodes = 17 * 13;

// c = x of node 0 / 2 - z of node 1.
class Loaded {
 public:
  explicit Loaded(size_t n_nodes, const std::string& kinds = "gauge") {
    std::vector<int16_t> weight(3 * n_nodes);
    weight[0] = 512;
    weight[5] = -1024;
    file_ = test::held(test::CalibrationBytes()
                           .meta("gauge.shift", "10")
                           .meta("kinds", kinds)
                           .tensor("gauge.weight", "I16", {static_cast<int>(n_nodes), 3}, weight));
  }
  [[nodiscard]] Result<DepthGauge> gauge() const { return DepthGauge::load(file_->get(), test::round_board()); }

 private:
  std::shared_ptr<const CalibrationFile> file_;
};

DisplacementUm um_q3(int raw) { return DisplacementUm::from_raw(static_cast<int16_t>(raw)); }

TEST(DepthGauge, LiftsNodesAndDepthByWhatTheNodesSay) {
  const Loaded loaded(kNodes);
  auto gauge = loaded.gauge();
  ASSERT_TRUE(gauge) << gauge.error().message;
  std::vector<NodeDisplacement> node(kNodes);
  node[0].x = um_q3(1'001);
  node[1].z = um_q3(-299);
  EXPECT_EQ(gauge.value().constant_q3(node), 800);  // 500.5 + 299, half up
  std::vector<DisplacementUm> depth(4, um_q3(-100));
  SaturationCounter saturations;
  gauge.value().run(node, depth, saturations);
  EXPECT_EQ(node[1].z.raw(), 501);
  EXPECT_EQ(node[16].z.raw(), 800);
  EXPECT_EQ(node[16].x.raw(), 320);   // 64000 800 / 160000: (8, -6) mm, 20 mm from the pinhole
  EXPECT_EQ(node[16].y.raw(), -240);  // -48000 800 / 160000
  for (const DisplacementUm z : depth) EXPECT_EQ(z.raw(), 700);
  EXPECT_EQ(saturations.count, 0U);
}

TEST(DepthGauge, CountsWhatDoesNotFit) {
  const Loaded loaded(kNodes);
  auto gauge = loaded.gauge();
  ASSERT_TRUE(gauge);
  std::vector<NodeDisplacement> node(kNodes);
  node[1].z = um_q3(-1'000);
  std::vector<DisplacementUm> depth = {um_q3(32'000), um_q3(31'000)};
  SaturationCounter saturations;
  gauge.value().run(node, depth, saturations);
  EXPECT_EQ(depth[0].raw(), 32'767);
  EXPECT_EQ(depth[1].raw(), 32'000);
  EXPECT_EQ(saturations.count, 1U);
}

TEST(DepthGauge, RefusesATableOfOtherNodes) {
  const Loaded loaded(kNodes - 1);
  EXPECT_FALSE(loaded.gauge());
}

TEST(DepthGauge, RefusesRaysThatAreNoPinholes) {
  const Loaded loaded(kNodes, "camera,gauge");
  const auto gauge = loaded.gauge();
  ASSERT_FALSE(gauge);
  EXPECT_EQ(gauge.error().kind, ErrorKind::kRefused);
  EXPECT_NE(gauge.error().message.find("camera"), std::string::npos);
}

}  // namespace
}  // namespace ruffini
