#include "estimators/marker_depth.h"

#include <gtest/gtest.h>

#include "support/held_calibration.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

constexpr int kNodes = 17 * 13;

// u_z = d_x of the same node.
class Loaded {
 public:
  explicit Loaded(int n_nodes, const std::string& kinds = "marker_depth") {
    std::vector<int16_t> rows(static_cast<size_t>(n_nodes) * 2 * static_cast<size_t>(n_nodes));
    for (size_t i = 0; i < static_cast<size_t>(n_nodes); ++i)
      rows[i * 2 * static_cast<size_t>(n_nodes) + 2 * i] = 8'192;
    file_ = test::held(test::CalibrationBytes()
                           .meta("kinds", kinds)
                           .meta("marker_depth.out_shift", "13")
                           .dense_program("marker_depth", n_nodes, 2 * n_nodes)
                           .dense_entries("marker_depth", n_nodes, 2 * n_nodes, rows)
                           .dense_shifts("marker_depth", n_nodes, 2 * n_nodes));
  }
  [[nodiscard]] Result<MarkerDepth> depth() const { return MarkerDepth::load(file_->get(), test::round_board()); }

 private:
  std::shared_ptr<const CalibrationFile> file_;
};

NodeDisplacement seen(int x_q3, int y_q3) {
  return {DisplacementUm::from_raw(static_cast<int16_t>(x_q3)), DisplacementUm::from_raw(static_cast<int16_t>(y_q3)),
          DisplacementUm::from_raw(0)};
}

TEST(MarkerDepth, TakesPerspectiveOffWithTheDepthItFinds) {
  const Loaded loaded(kNodes);
  auto depth = loaded.depth();
  ASSERT_TRUE(depth) << depth.error().message;
  std::vector<NodeDisplacement> node(kNodes, seen(0, 0));
  node[16] = seen(800, -320);  // at (8, -6) mm, 20 mm from the pinhole: 100 um nearer, 100 um / 20 mm of its place
  SaturationCounter saturations;
  depth.value().run(node, saturations);
  EXPECT_EQ(node[16].z.raw(), 800);
  EXPECT_EQ(node[16].x.raw(), 800 + 324);   // (64000 + 800) 800 / 160000
  EXPECT_EQ(node[16].y.raw(), -320 - 242);  // (-48000 - 320) 800 / 160000 = -241.6
  EXPECT_EQ(node[15].x.raw(), 0);
  EXPECT_EQ(node[15].z.raw(), 0);
  EXPECT_EQ(saturations.count, 0U);
}

TEST(MarkerDepth, CountsWhatDoesNotFit) {
  const Loaded loaded(kNodes);
  auto depth = loaded.depth();
  ASSERT_TRUE(depth);
  std::vector<NodeDisplacement> node(kNodes, seen(0, 0));
  node[16] = seen(30'000, 0);
  SaturationCounter saturations;
  depth.value().run(node, saturations);
  EXPECT_EQ(node[16].x.raw(), 32'767);
  EXPECT_EQ(saturations.count, 1U);
}

TEST(MarkerDepth, RefusesATableOfOtherNodes) {
  const Loaded loaded(kNodes - 1);
  EXPECT_FALSE(loaded.depth());
}

TEST(MarkerDepth, RefusesRaysThatAreNoPinholes) {
  const Loaded loaded(kNodes, "camera,marker_depth");
  const auto depth = loaded.depth();
  ASSERT_FALSE(depth);
  EXPECT_EQ(depth.error().kind, ErrorKind::kRefused);
  EXPECT_NE(depth.error().message.find("camera"), std::string::npos);
}

}  // namespace
}  // namespace ruffini
