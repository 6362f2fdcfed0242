#include "image/displacement.h"

#include <gtest/gtest.h>

#include "support/dot_picture.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

constexpr int kDepthX = 160;
constexpr int kDepthY = 120;

// Markers at their nominal places, each moved by move(x_um, y_um) pixels.
template <typename Move>
std::vector<Marker> markers(const BoardSettings& board, Move move) {
  std::vector<Marker> out;
  for (const test::Place& p : test::nominal_dots(board)) {
    const auto [dx, dy] = move((p.x - 79.5) * 100, (p.y - 59.5) * 100);
    const auto q16 = [](double px) { return ImagePx::from_raw(static_cast<int32_t>(std::lround(px * 65536))); };
    out.push_back({q16(p.x), q16(p.y), q16(dx), q16(dy), false, false});
  }
  return out;
}

std::vector<NodeDisplacement> run(const BoardSettings& board, const std::vector<Marker>& m,
                                  const std::vector<DisplacementUm>& depth) {
  Displacement stage(board);
  stage.learn(m);
  std::vector<NodeDisplacement> out(static_cast<size_t>(stage.nodes().count()));
  SaturationCounter saturations;
  stage.run(m, depth, out, saturations);
  EXPECT_EQ(saturations.count, 0U);
  return out;
}

// Node places of the board: 17 x 13 nodes over 16 x 12 mm, 1 mm apart, from the pad's centre.
double node_x_um(size_t i) { return static_cast<double>(i % 17) * 1000 - 8000; }
double node_y_um(size_t i) { return static_cast<double>(i / 17) * 1000 - 6000; }

TEST(Displacement, AUniformShiftIsTheSameEverywhere) {
  const BoardSettings board = test::round_board();
  const auto u = run(board, markers(board, [](double, double) { return std::pair{1.25, -0.5}; }), {});
  ASSERT_EQ(u.size(), 17U * 13U);
  for (const NodeDisplacement& node : u) {
    EXPECT_EQ(node.x.raw(), 1000);  // 1.25 px = 125 um
    EXPECT_EQ(node.y.raw(), -400);
    EXPECT_EQ(node.z.raw(), 0);
  }
}

TEST(Displacement, ALinearFieldIsReproducedInsideAndExtrapolatedOneMillimetreOutside) {
  const BoardSettings board = test::round_board();
  const auto u =
      run(board, markers(board, [](double x, double y) { return std::pair{0.0004 * x, 0.0002 * y + 1}; }), {});
  for (size_t i = 0; i < u.size(); ++i) {
    // Beyond one marker pitch outside the lattice (x: 6000 + 1500) the extrapolation stops.
    if (std::abs(node_x_um(i)) > 7500) continue;
    EXPECT_NEAR(u[i].x.raw() / 8.0, 0.04 * node_x_um(i), 0.3) << i;
    EXPECT_NEAR(u[i].y.raw() / 8.0, 0.02 * node_y_um(i) + 100, 0.3) << i;
  }
}

TEST(Displacement, AnAskewLatticeDoesNotShiftTheField) {
  // Printed 0.4 pitch off, turned by 2 degrees and 3 % too wide; the field is known at every place.
  const BoardSettings board = test::round_board();
  std::vector<Marker> askew;
  for (const test::Place& p : test::nominal_dots(board)) {
    const double x = 1.03 * (p.x - 79.5) - 0.035 * (p.y - 59.5) + 6;
    const double y = 1.03 * (p.y - 59.5) + 0.035 * (p.x - 79.5) - 6;
    const auto q16 = [](double px) { return ImagePx::from_raw(static_cast<int32_t>(std::lround(px * 65536))); };
    askew.push_back({q16(79.5 + x), q16(59.5 + y), q16(0.04 * x), q16(-0.03 * y), false, false});
  }
  const auto u = run(board, askew, {});
  for (size_t i = 0; i < u.size(); ++i) {
    if (std::abs(node_x_um(i)) > 6000 || std::abs(node_y_um(i)) > 4500) continue;
    EXPECT_NEAR(u[i].x.raw() / 8.0, 0.04 * node_x_um(i), 0.4) << i;
    EXPECT_NEAR(u[i].y.raw() / 8.0, -0.03 * node_y_um(i), 0.4) << i;
  }
}

TEST(Displacement, APadThatComesNearerDoesNotSeemToShift) {
  // u_z = -500 um everywhere and no lateral motion: p - c = f X / (H + u_z), so dots spread by 1 / (1 - 0.025).
  const BoardSettings board = test::round_board();
  const std::vector<DisplacementUm> depth(kDepthX * kDepthY, DisplacementUm::from_raw(-4000));
  const double spread = 20'000.0 / 19'500 - 1;
  const auto u = run(
      board, markers(board, [&](double x, double y) { return std::pair{x * spread / 100, y * spread / 100}; }), depth);
  for (size_t i = 0; i < u.size(); ++i) {
    EXPECT_NEAR(u[i].x.raw() / 8.0, 0, 0.5) << i;
    EXPECT_NEAR(u[i].y.raw() / 8.0, 0, 0.5) << i;
    EXPECT_EQ(u[i].z.raw(), -4000) << i;
  }
}

TEST(Displacement, DepthIsReadWhereTheNodeHasMovedTo) {
  // The depth image falls by 2 um per pixel along x; the surface has moved by +300 um in x.
  const BoardSettings board = test::round_board();
  std::vector<DisplacementUm> depth;
  for (int i = 0; i < kDepthX * kDepthY; ++i) {
    depth.push_back(DisplacementUm::from_raw(static_cast<int16_t>(-16 * (i % kDepthX))));
  }
  // A marker at X + 300 under depth z shows at f (X + 300) / (H + z): solve for its pixel.
  const auto pixel = [](double x_um) {
    double p = 79.5 + x_um / 100;
    for (int k = 0; k < 20; ++k) p = 79.5 + 200 * x_um / (20'000 - 2 * p);
    return p;
  };
  const auto moved = markers(board, [&](double x, double y) {
    const double p = pixel(x + 300);
    return std::pair{p - (79.5 + x / 100), 200 * y / (20'000 - 2 * p) - y / 100};
  });
  const auto u = run(board, moved, depth);
  for (size_t i = 0; i < u.size(); ++i) {
    if (std::abs(node_x_um(i)) > 7000) continue;
    EXPECT_NEAR(u[i].x.raw() / 8.0, 300, 1.0) << i;
    EXPECT_NEAR(u[i].y.raw() / 8.0, 0, 1.0) << i;
    EXPECT_NEAR(u[i].z.raw() / 8.0, -2 * pixel(node_x_um(i) + 300), 0.5) << i;
  }
}

TEST(Displacement, ANodeIsFilledWhereLostMarkersHaveHalfOfItsWeight) {
  const BoardSettings board = test::round_board();
  std::vector<Marker> m = markers(board, [](double, double) { return std::pair{0.0, 0.0}; });
  Displacement stage(board);
  stage.learn(m);
  std::vector<uint8_t> is_filled(static_cast<size_t>(stage.nodes().count()));
  const auto filled_nodes = [&] {
    stage.mark_filled(m, is_filled);
    return std::count(is_filled.begin(), is_filled.end(), 1);
  };
  EXPECT_EQ(filled_nodes(), 0);
  m[3 * 9 + 4].is_lost = true;  // upon node (8, 6); a node 2/3 of a pitch away has a third of its weight there
  EXPECT_EQ(filled_nodes(), 1);
  EXPECT_EQ(is_filled[6 * 17 + 8], 1);
  m[3 * 9 + 5].is_lost = true;  // between nodes (9, 6) and (10, 6), a third of a pitch from each
  EXPECT_EQ(filled_nodes(), 3);
  EXPECT_EQ(is_filled[6 * 17 + 9] + is_filled[6 * 17 + 10], 2);
  for (Marker& marker : m) marker.is_lost = true;
  EXPECT_EQ(filled_nodes(), 17 * 13);
}

TEST(Displacement, OnlyNodesInsideTheWindowAreReported) {
  BoardSettings board = test::round_board();
  board.window = {.min_x_um = 1'500, .min_y_um = 2'000, .max_x_um = 14'000, .max_y_um = 9'999};
  const Displacement stage(board);
  EXPECT_EQ(stage.nodes().n_x, 13);  // 2 to 14 mm
  EXPECT_EQ(stage.nodes().n_y, 8);   // 2 to 9 mm
}

TEST(Displacement, BeyondFourMillimetresItSaturatesAndCounts) {
  const BoardSettings board = test::round_board();
  Displacement stage(board);
  std::vector<NodeDisplacement> out(static_cast<size_t>(stage.nodes().count()));
  SaturationCounter saturations;
  const std::vector<Marker> far = markers(board, [](double, double) { return std::pair{50.0, 0.0}; });
  stage.learn(far);
  stage.run(far, {}, out, saturations);
  EXPECT_GT(saturations.count, 0U);
  EXPECT_EQ(out[100].x.raw(), 32767);
}

}  // namespace
}  // namespace ruffini
