#include "estimators/wrench.h"

#include <gtest/gtest.h>

#include <limits>

#include "support/test_board.h"

namespace ruffini {
namespace {

// 17 x 13 nodes, 1 mm apart, over 16 x 12 mm; lsb 10 uN.
struct Pad {
  NodeGrid grid{test::round_board()};
  std::vector<NodeForce> force = std::vector<NodeForce>(17 * 13);
  NodeForce& at(int column, int row) { return force[static_cast<size_t>(row * 17 + column)]; }
};

TEST(Wrench, OneForceAtOneNode) {
  Pad pad;
  pad.at(11, 4) = {100, -200, -300};  // X = +3 mm, Y = -2 mm; 1, -2, -3 mN
  const Wrench w = sum_wrench(pad.grid, pad.force, 10);
  EXPECT_EQ(w.force_x_un, 1'000);
  EXPECT_EQ(w.force_y_un, -2'000);
  EXPECT_EQ(w.force_z_un, -3'000);
  EXPECT_EQ(w.torque_x_un_um, 6'000'000);   // Y fz = -2000 um x -3000 uN
  EXPECT_EQ(w.torque_y_un_um, 9'000'000);   // -X fz
  EXPECT_EQ(w.torque_z_un_um, -4'000'000);  // X fy - Y fx = -6e6 + 2e6
}

TEST(Wrench, MovedNodesHaveMovedArms) {
  Pad pad;
  pad.at(11, 4) = {100, -200, -300};  // 1, -2, -3 mN
  std::vector<NodeDisplacement> u(pad.force.size());
  const auto um = [](int value) { return DisplacementUm::from_raw(static_cast<int16_t>(8 * value)); };
  u[4 * 17 + 11] = {um(500), um(-100), um(-400)};
  const Wrench still = sum_wrench(pad.grid, pad.force, 10);
  Wrench w = still;
  SaturationCounter saturations;
  add_displacement_moment(pad.force, u, 10, w, saturations);
  EXPECT_EQ(w.torque_x_un_um - still.torque_x_un_um, 300'000 - 800'000);     // uy fz - uz fy
  EXPECT_EQ(w.torque_y_un_um - still.torque_y_un_um, -400'000 + 1'500'000);  // uz fx - ux fz
  EXPECT_EQ(w.torque_z_un_um - still.torque_z_un_um, -1'000'000 + 100'000);  // ux fy - uy fx
  EXPECT_EQ(w.force_z_un, still.force_z_un);
  EXPECT_EQ(saturations.count, 0U);
}

TEST(Wrench, ACoupleHasNoForce) {
  Pad pad;
  pad.at(8, 2).x = 50;
  pad.at(8, 10).x = -50;  // 8 mm apart along y
  const Wrench w = sum_wrench(pad.grid, pad.force, 10);
  EXPECT_EQ(w, (Wrench{.torque_z_un_um = 4'000'000}));
}

TEST(Wrench, NodesBetweenMicrometresAreRoundedOnceAtTheEnd) {
  BoardSettings board = test::round_board();
  board.pad.size_x_um = 16'001;  // nodes 1000.0625 um apart
  board.window.max_x_um = 16'001;
  const NodeGrid grid(board);
  std::vector<NodeForce> force(17 * 13);
  force[9].z = -1;                                                // X = 1000.0625 um, 10 uN
  EXPECT_EQ(sum_wrench(grid, force, 10).torque_y_un_um, 10'001);  // 10000.625
  force[9].z = 0;
  for (int row = 0; row < 13; ++row) force[static_cast<size_t>(row * 17 + 9)].z = -1;
  EXPECT_EQ(sum_wrench(grid, force, 10).torque_y_un_um, 130'008);  // 130008.125
}

TEST(Wrench, IsExactWithEveryNodeAtItsLimit) {
  Pad pad;
  for (NodeForce& f : pad.force) f = {std::numeric_limits<int32_t>::min(), 0, std::numeric_limits<int32_t>::min()};
  const Wrench w = sum_wrench(pad.grid, pad.force, 1'000);
  EXPECT_EQ(w.force_x_un, -474'593'886'208'000);  // -2^31 x 221 x 1000
  EXPECT_EQ(w.torque_x_un_um, 0);
  for (NodeForce& f : pad.force) f = {};
  for (int row = 0; row < 13; ++row) pad.at(16, row).z = std::numeric_limits<int32_t>::min();
  EXPECT_EQ(sum_wrench(pad.grid, pad.force, 1'000).torque_y_un_um, 223'338'299'392'000'000);  // 8 mm x 13 x 2^31 x 1000
}

}  // namespace
}  // namespace ruffini
