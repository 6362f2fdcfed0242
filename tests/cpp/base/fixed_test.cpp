#include "base/fixed.h"

#include <gtest/gtest.h>

namespace ruffini {
namespace {

TEST(RoundShift, IsHalfUpOnBothSidesOfZero) {
  EXPECT_EQ(round_shift(3, 1), 2);
  EXPECT_EQ(round_shift(-3, 1), -1);
  EXPECT_EQ(round_shift(-1, 1), 0);
  EXPECT_EQ(round_shift(5, 2), 1);
  EXPECT_EQ(round_shift(6, 2), 2);
  EXPECT_EQ(round_shift(-6, 2), -1);
  EXPECT_EQ(round_shift(-7, 2), -2);
}

TEST(FloorDiv, RoundsTowardsMinusInfinity) {
  EXPECT_EQ(floor_div(7, 2), 3);
  EXPECT_EQ(floor_div(-7, 2), -4);
  EXPECT_EQ(floor_div(-8, 2), -4);
  EXPECT_EQ(floor_div(0, 5), 0);
}

TEST(Saturate, ClampsAndCountsEachValueOnce) {
  SaturationCounter counter;
  EXPECT_EQ(saturate_raw<int16_t>(32767, counter), 32767);
  EXPECT_EQ(saturate_raw<int16_t>(-32768, counter), -32768);
  EXPECT_EQ(counter.count, 0U);
  EXPECT_EQ(saturate_raw<int16_t>(32768, counter), 32767);
  EXPECT_EQ(saturate_raw<int16_t>(int64_t{-1} << 40, counter), -32768);
  EXPECT_EQ(counter.count, 2U);
}

TEST(Fixed, ConstantsRoundToTheNearestStep) {
  EXPECT_EQ(DisplacementUm::from_real(1.0).raw(), 8);
  EXPECT_EQ(DisplacementUm::from_real(-0.1).raw(), -1);
  EXPECT_EQ(Slope::from_real(0.5).raw(), 2048);
}

TEST(Narrow, DropsFractionBitsAndSaturates) {
  SaturationCounter counter;
  EXPECT_EQ((narrow<DisplacementUm, 11>(8 << 8, counter).raw()), 8);
  EXPECT_EQ((narrow<DisplacementUm, 11>((8 << 8) + 128, counter).raw()), 9);
  EXPECT_EQ((narrow<DisplacementUm, 11>(-128, counter).raw()), 0);
  EXPECT_EQ(counter.count, 0U);
  EXPECT_EQ((narrow<DisplacementUm, 11>(int64_t{1} << 30, counter).raw()), 32767);
  EXPECT_EQ(counter.count, 1U);
}

}  // namespace
}  // namespace ruffini
