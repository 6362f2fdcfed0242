#include "image/difference.h"

#include <gtest/gtest.h>

#include "image/rest.h"

namespace ruffini {
namespace {

struct Outcome {
  std::vector<RelativeChange> change;
  ExposureCounts exposure;
  SaturationCounter saturations;
};

// One row of pixels against one row of rest pixels.
Outcome run(const std::vector<uint8_t>& rest_pixels, const std::vector<uint8_t>& pixels) {
  const int width = static_cast<int>(pixels.size() / 3);
  const auto stride = static_cast<ptrdiff_t>(pixels.size());
  Rest rest(width, 1, 1);
  rest.add({rest_pixels.data(), width, 1, 3, stride});
  Outcome out{std::vector<RelativeChange>(pixels.size()), {}, {}};
  out.exposure = difference({pixels.data(), width, 1, 3, stride}, rest.reciprocal(), out.change, out.saturations);
  return out;
}

TEST(Difference, IsRelativeToRest) {
  const Outcome out = run({100, 100, 100, 100, 60, 3}, {100, 200, 50, 0, 66, 4});
  const std::vector<int> expected = {0, 4096, -2048, -4096, 410, 1365};  // 0, +100, -50, -100, +10, +33.3 %
  for (size_t i = 0; i < expected.size(); ++i) EXPECT_EQ(out.change[i].raw(), expected[i]) << i;
  EXPECT_EQ(out.saturations.count, 0U);
}

TEST(Difference, GlareOnABlackPixelSaturatesAndIsCounted) {
  const Outcome out = run({1, 1, 1}, {255, 8, 9});
  EXPECT_EQ(out.change[0].raw(), 32767);
  EXPECT_EQ(out.change[1].raw(), 7 * 4096);
  EXPECT_EQ(out.change[2].raw(), 32767);  // +800 % is one step beyond
  EXPECT_EQ(out.saturations.count, 2U);
}

TEST(Difference, CountsDarkAndFullPixels) {
  const std::vector<uint8_t> rest(12, 100);
  const Outcome out = run(rest, {7, 7, 7, 7, 8, 7, 255, 1, 1, 254, 254, 254});
  EXPECT_EQ(out.exposure.dark, 1);
  EXPECT_EQ(out.exposure.full, 1);
}

}  // namespace
}  // namespace ruffini
