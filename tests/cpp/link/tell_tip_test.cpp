#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

#include "link/messages.h"

namespace ruffini {
namespace {

TEST(TellTip, AToolsPlaceTurnAndHowSureTheyAreHaveTheirOwnFields) {
  ruffini_Contact said = ruffini_Contact_init_zero;
  MessageEncoder::tell_tip({.is_touched = true,
                            .force_un = 400'000,
                            .way_um = 310,
                            .x_um = -1'200,
                            .y_um = 700,
                            .roll_urad = -52'000,
                            .pitch_urad = 174'533,
                            .area_um2 = 28'000'000,
                            .flat_um2 = 51'234'000,
                            .flat_sigma_um2 = 2'345'999,
                            .sigma = {9'000, 11, 120, 130, 4'000, 5'000, 640'000},
                            .axis_1e6 = {0, -600'000, 800'000}},
                           said);
  EXPECT_EQ(said.force_sigma_un, 9'000u);
  EXPECT_EQ(said.flat_area_um2_k, 51'234u);
  EXPECT_EQ(said.flat_area_sigma_um2_k, 2'345u);
  ASSERT_EQ(said.normal_force_un_count, 3);
  EXPECT_EQ(said.normal_force_un[1], 240'000) << "into the fingertip, against the tool's axis";
  EXPECT_EQ(said.normal_force_un[2], -320'000);
  ASSERT_EQ(said.tool_um_count, 3);
  EXPECT_EQ(said.tool_um[0], -1'200);
  EXPECT_EQ(said.tool_um[1], 700);
  EXPECT_EQ(said.tool_um[2], 310);
  ASSERT_EQ(said.turn_urad_count, 2);
  EXPECT_EQ(said.turn_urad[0], -52'000);
  EXPECT_EQ(said.turn_urad[1], 174'533);
  ASSERT_EQ(said.tool_sigma_count, 7);
  const std::vector<uint32_t> sigma(said.tool_sigma, said.tool_sigma + 7);
  EXPECT_EQ(sigma, (std::vector<uint32_t>{9'000, 120, 130, 11, 4'000, 5'000, 640})) << "way after X and Y; 1e-3 mm^2";
}

}  // namespace
}  // namespace ruffini
