#include "image/glow.h"

#include <gtest/gtest.h>

#include <random>
#include <string>

#include "image/glow_regions.h"
#include "image/kernels.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

BoardSettings glowing(int width, int height) {
  BoardSettings board = test::round_board();
  board.camera.width_px = width;
  board.camera.height_px = height;
  board.skin = {.weights = {3, 4, 1}, .level = 40, .min_area_px = 20, .averaged_frames = 1};
  return board;
}

struct Seen {
  std::vector<int16_t> glow;
  std::vector<int16_t> smoothed;
  bool operator==(const Seen&) const = default;
};

Seen look(const BoardSettings& board, const kernels::Kernels& version, std::span<const uint16_t> rest,
          const std::vector<uint8_t>& pixels) {
  Glow glow(board, version.glow, version.smooth);
  glow.learn(rest);
  const int width = board.camera.width_px;
  glow.run({pixels.data(), width, board.camera.height_px, 3, ptrdiff_t{3} * width});
  glow.smooth();
  return {{glow.plane().begin(), glow.plane().end()}, {glow.smoothed().begin(), glow.smoothed().end()}};
}

TEST(Glow, IsTheSameOnEveryProcessorAtAnySizeAndLevel) {
  std::mt19937 random(3);  // NOLINT: the same numbers on every run
  for (const auto& [width, height] : {std::pair{64, 20}, {67, 21}, {31, 40}, {16, 16}, {49, 17}}) {
    const auto n = static_cast<size_t>(width * height * 3);
    for (const int most : {255, 3, 0}) {
      std::vector<uint16_t> rest(n);
      std::vector<uint8_t> pixels(n);
      for (uint16_t& r : rest) r = static_cast<uint16_t>(random() % (most == 0 ? 65'536 : 16 * 255 + 1));
      for (uint8_t& p : pixels) p = static_cast<uint8_t>(most == 0 ? 0 : 255 - random() % static_cast<uint32_t>(most));
      const BoardSettings board = glowing(width, height);
      const Seen reference = look(board, kernels::kScalar, rest, pixels);
      EXPECT_EQ(look(board, kernels::kNeon, rest, pixels), reference) << width << "x" << height << ", " << most;
#if defined(__x86_64__)
      if (!__builtin_cpu_supports("avx2")) continue;
      EXPECT_EQ(look(board, kernels::kAvx2, rest, pixels), reference) << width << "x" << height << ", " << most;
#endif
    }
  }
}

// A flat picture stays as it is, and a point of light becomes a Gaussian of two pixels whose sum stays.
TEST(Glow, SmoothingKeepsTheSum) {
  const BoardSettings board = glowing(64, 48);
  const std::vector<uint16_t> rest(size_t{64} * 48 * 3, 0);
  std::vector<uint8_t> pixels(rest.size(), 100);
  const Seen flat = look(board, kernels::kScalar, rest, pixels);
  for (const int16_t value : flat.smoothed) ASSERT_NEAR(value, 4 * 8 * 100, 7);
  std::fill(pixels.begin(), pixels.end(), uint8_t{0});
  for (size_t c = 0; c < 3; ++c) pixels[3 * (24 * 64 + 30) + c] = 250;
  const Seen point = look(board, kernels::kScalar, rest, pixels);
  int sum = 0;
  int64_t moment = 0;
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      const int value = point.smoothed[static_cast<size_t>(64 * y + x)];
      sum += value;
      moment += int64_t{value} * (x - 30) * (x - 30);
    }
  }
  EXPECT_NEAR(sum, 4 * 8 * 250, 80);
  EXPECT_NEAR(static_cast<double>(moment) / sum, 4.0, 0.3);  // sigma 2, cut off at three sigma
}

TEST(GlowRegions, FindsPeakAndRegionsLargestFirst) {
  const BoardSettings board = glowing(64, 48);
  std::vector<int16_t> smoothed(size_t{64} * 48, 0);
  const auto paint = [&](int x0, int y0, int w, int h, int16_t value) {
    for (int y = y0; y < y0 + h; ++y) {
      for (int x = x0; x < x0 + w; ++x) smoothed[static_cast<size_t>(64 * y + x)] = value;
    }
  };
  paint(2, 3, 6, 5, 400);     // 30 px
  paint(20, 10, 9, 9, 200);   // 81 px
  paint(40, 30, 4, 4, 900);   // 16 px: too few, but the brightest
  paint(50, 2, 10, 10, 160);  // as bright as the level: not above it
  GlowRegions regions(board);
  regions.find(smoothed);
  EXPECT_EQ(regions.n_found(), 2);
  ASSERT_EQ(regions.regions().size(), 2U);
  EXPECT_EQ(regions.regions()[0].area_px, 81);
  EXPECT_EQ(regions.regions()[0].x.raw(), 24 << 16);
  EXPECT_EQ(regions.regions()[0].y.raw(), 14 << 16);
  EXPECT_EQ(regions.regions()[0].mean_q2, 200);
  EXPECT_EQ(regions.regions()[1].x.raw(), (2 << 16) + (5 << 15));
  EXPECT_EQ(regions.peak().x_px, 40);
  EXPECT_EQ(regions.peak().y_px, 30);
  EXPECT_EQ(regions.peak().level_q2, 900);
}

}  // namespace
}  // namespace ruffini
