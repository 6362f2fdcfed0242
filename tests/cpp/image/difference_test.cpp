#include "image/difference.h"

#include <gtest/gtest.h>

#include "image/rest.h"

namespace ruffini {
namespace {

struct Outcome {
  std::vector<RelativeChange> change;  // planes of B, G and R
  std::vector<uint16_t> grey;
  ExposureCounts exposure;
};

// One row of pixels against one row of rest pixels.
Outcome run(const std::vector<uint8_t>& rest_pixels, const std::vector<uint8_t>& pixels) {
  const int width = static_cast<int>(pixels.size() / 3);
  const auto stride = static_cast<ptrdiff_t>(pixels.size());
  Rest rest(width, 1, 1);
  rest.add({rest_pixels.data(), width, 1, 3, stride});
  Outcome out{std::vector<RelativeChange>(pixels.size()), std::vector<uint16_t>(pixels.size() / 3), {}};
  out.exposure = difference({pixels.data(), width, 1, 3, stride}, rest, out.change, out.grey);
  return out;
}

TEST(Difference, IsRelativeToRest) {
  const Outcome out = run({100, 100, 100, 100, 60, 200}, {100, 200, 50, 0, 66, 250});
  const std::vector<int> expected = {0, -4096, 4096, 410, -2048, 1024};  // 0, -100; +100, +10; -50, +25 %
  for (size_t i = 0; i < expected.size(); ++i) EXPECT_EQ(out.change[i].raw(), expected[i]) << i;
}

TEST(Difference, DarkRestIsMeasuredAgainst32LevelsAndFits16Bits) {
  const Outcome out = run({0, 0, 16}, {255, 0, 32});
  EXPECT_EQ(out.change[0].raw(), 32639);  // 255 / 32
  EXPECT_EQ(out.change[1].raw(), 0);      // at rest, however dark
  EXPECT_EQ(out.change[2].raw(), 2048);   // 16 / 32
}

TEST(Difference, GreyCountsGreenTwice) {
  const Outcome out = run(std::vector<uint8_t>(6, 100), {1, 2, 4, 255, 255, 255});
  EXPECT_EQ(out.grey, (std::vector<uint16_t>{12 * 9, 12 * 1020}));
}

TEST(Difference, CountsDarkAndFullPixels) {
  const std::vector<uint8_t> rest(12, 100);
  const Outcome out = run(rest, {7, 7, 7, 7, 8, 7, 255, 1, 1, 254, 254, 254});
  EXPECT_EQ(out.exposure.dark, 1);
  EXPECT_EQ(out.exposure.full, 1);
}

}  // namespace
}  // namespace ruffini
