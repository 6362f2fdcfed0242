#include "image/block_edges.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

namespace ruffini {
namespace {

using Pixels = std::vector<uint8_t>;
constexpr int kWidth = 320;
constexpr int kHeight = 240;

// A wave with noise; every block of 8 x 8 a little brighter or darker than it should be.
Pixels picture(unsigned seed, double block_levels, double phase = 0) {
  std::minstd_rand lot(seed);
  std::normal_distribution<double> noise;
  std::vector<double> block(size_t{kWidth} * kHeight / 64);
  for (double& level : block) level = block_levels * noise(lot);
  Pixels pixels;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double level = block[static_cast<size_t>(y / 8 * (kWidth / 8) + x / 8)];
      for (int c = 0; c < 3; ++c) {
        pixels.push_back(static_cast<uint8_t>(std::lround(100 + 30 * std::sin(0.3 * x + phase) + level + noise(lot))));
      }
    }
  }
  return pixels;
}

FrameView view(const Pixels& pixels) { return {pixels.data(), kWidth, kHeight, 3, ptrdiff_t{3} * kWidth}; }

TEST(BlockEdges, BlocksThatRestDidNotHave) {
  BlockEdges blocks(kWidth, kHeight);
  for (unsigned seed = 1; seed <= 4; ++seed) blocks.add_rest(view(picture(seed, 0)));
  for (unsigned seed = 10; seed < 40; ++seed) {
    EXPECT_FALSE(blocks.run(view(picture(seed, 0, 0.1 * seed)))) << seed;
    EXPECT_TRUE(blocks.run(view(picture(seed, 2)))) << seed;
  }
}

TEST(BlockEdges, SharpEdgesAtTheBlocksEdgesAreNotCompression) {
  BlockEdges blocks(kWidth, kHeight);
  for (unsigned seed = 1; seed <= 4; ++seed) blocks.add_rest(view(picture(seed, 0)));
  Pixels face = picture(9, 0);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 80; x < 160; ++x) face[size_t{3} * static_cast<size_t>(y * kWidth + x)] += 60;
  }
  EXPECT_FALSE(blocks.run(view(face))) << "a face with a sharp rim";
}

TEST(BlockEdges, ACameraThatCompressesIsComparedWithItself) {
  BlockEdges blocks(kWidth, kHeight);
  EXPECT_FALSE(blocks.run(view(picture(1, 3)))) << "no rest yet";
  blocks.add_rest(view(picture(2, 3)));
  EXPECT_FALSE(blocks.run(view(picture(3, 3))));
  EXPECT_TRUE(blocks.run(view(picture(4, 9))));
  blocks.add_rest(view(picture(5, 9)));
  blocks.begin_rest();
  blocks.add_rest(view(picture(6, 0)));
  EXPECT_TRUE(blocks.run(view(picture(7, 2)))) << "a new rest";
}

TEST(BlockEdges, APictureTooSmallIsNotJudged) {
  const Pixels smooth = picture(1, 0);
  const Pixels coded = picture(2, 9);
  for (const int width : {BlockEdges::kMinColumns - 1, BlockEdges::kMinColumns}) {
    BlockEdges blocks(width, kHeight);
    blocks.add_rest({smooth.data(), width, kHeight, 3, ptrdiff_t{3} * kWidth});
    const bool has_blocks = blocks.run({coded.data(), width, kHeight, 3, ptrdiff_t{3} * kWidth});
    EXPECT_EQ(has_blocks, width == BlockEdges::kMinColumns) << width;
  }
}

}  // namespace
}  // namespace ruffini
