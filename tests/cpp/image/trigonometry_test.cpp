#include "image/trigonometry.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace ruffini {
namespace {

constexpr int32_t kOne = 1 << 30;

TEST(CosPi, KnowsTheExactAngles) {
  EXPECT_EQ(cos_pi_q30(0, 1), kOne);
  EXPECT_EQ(cos_pi_q30(1, 3), kOne / 2);
  EXPECT_EQ(cos_pi_q30(1, 2), 0);
  EXPECT_EQ(cos_pi_q30(2, 3), -kOne / 2);
  EXPECT_EQ(cos_pi_q30(1, 1), -kOne);
  EXPECT_EQ(cos_pi_q30(1, 4), 759'250'125);  // sqrt(1/2) 2^30 = 759250124.99...
  EXPECT_EQ(cos_pi_q30(-1, 4), 759'250'125);
  EXPECT_EQ(cos_pi_q30(9, 4), 759'250'125);
}

TEST(CosPi, IsTheNearestIntegerOverAFullTurn) {
  for (const int64_t n : {7, 160, 639, 1280}) {
    for (int64_t k = 0; k <= 2 * n; ++k) {
      const double exact = std::cos(std::numbers::pi * static_cast<double>(k) / static_cast<double>(n)) * kOne;
      EXPECT_NEAR(cos_pi_q30(k, n), exact, 0.5 + 1e-6) << k << "/" << n;
    }
  }
}

}  // namespace
}  // namespace ruffini
