#include "image/rest.h"

#include <gtest/gtest.h>

namespace ruffini {
namespace {

FrameView view(const std::vector<uint8_t>& pixels) { return {pixels.data(), 2, 1, 3, 6}; }

TEST(Rest, IsTheMeanInSixteenthsOfAGreyLevelRoundedHalfUp) {
  Rest rest(2, 1, 3);
  EXPECT_FALSE(rest.add(view({0, 10, 255, 1, 100, 7})));
  EXPECT_FALSE(rest.add(view({0, 11, 255, 0, 100, 7})));
  EXPECT_FALSE(rest.is_ready());
  EXPECT_TRUE(rest.add(view({1, 11, 255, 0, 101, 7})));
  EXPECT_TRUE(rest.is_ready());
  // Means 1/3, 32/3, 255, 1/3, 301/3, 7 in sixteenths.
  const std::vector<uint16_t> expected = {5, 171, 4080, 5, 1605, 112};
  EXPECT_TRUE(std::equal(expected.begin(), expected.end(), rest.image().begin()));
}

TEST(Rest, TheMostFramesOfTheBrightestPictureHaveTheirMean) {
  Rest rest(2, 1, Rest::kMaxFrames);
  for (int i = 1; i < Rest::kMaxFrames; ++i) ASSERT_FALSE(rest.add(view({255, 255, 255, 255, 255, 255})));
  ASSERT_TRUE(rest.add(view({255, 255, 255, 255, 255, 255})));
  EXPECT_EQ(rest.image()[0], 4'080);
  rest.restart(Rest::kMaxFrames + 1);  // the sum has no room for more
  for (int i = 1; i < Rest::kMaxFrames; ++i) ASSERT_FALSE(rest.add(view({255, 255, 255, 255, 255, 255})));
  EXPECT_TRUE(rest.add(view({255, 255, 255, 255, 255, 255})));
}

TEST(Rest, ReciprocalOfBlackIsThatOf32GreyLevels) {
  Rest rest(2, 1, 1);
  ASSERT_TRUE(rest.add(view({0, 32, 128, 255, 2, 0})));
  // Planes of B, G, R of two pixels; 2^15 does not fit.
  const std::vector<int16_t> expected = {32'767, 4'112, 32'767, 32'767, 8'192, 32'767};
  EXPECT_TRUE(std::equal(expected.begin(), expected.end(), rest.reciprocal().begin()));
}

TEST(Rest, RestartForgets) {
  Rest rest(2, 1, 1);
  ASSERT_TRUE(rest.add(view({9, 9, 9, 9, 9, 9})));
  rest.restart(2);
  EXPECT_FALSE(rest.is_ready());
  EXPECT_FALSE(rest.add(view({1, 1, 1, 1, 1, 1})));
  EXPECT_TRUE(rest.add(view({1, 1, 1, 1, 1, 1})));
  EXPECT_EQ(rest.image()[0], 16);
  rest.restart(0);  // the board's own number
  EXPECT_TRUE(rest.add(view({2, 2, 2, 2, 2, 2})));
  EXPECT_EQ(rest.image()[5], 32);
}

TEST(Rest, WhatIsGivenUpLeavesWhatWasBefore) {
  Rest rest(2, 1, 2);
  EXPECT_FALSE(rest.add(view({1, 1, 1, 1, 1, 1})));
  EXPECT_FALSE(rest.is_relearning());
  rest.cancel_learning();  // nothing was before: from the start
  EXPECT_FALSE(rest.is_ready());
  EXPECT_FALSE(rest.add(view({9, 9, 9, 9, 9, 9})));
  EXPECT_TRUE(rest.add(view({9, 9, 9, 9, 9, 9})));
  rest.cancel_learning();  // nothing is being learned
  EXPECT_TRUE(rest.is_ready());
  rest.restart(3);
  EXPECT_TRUE(rest.is_relearning());
  EXPECT_FALSE(rest.add(view({1, 1, 1, 1, 1, 1})));
  rest.cancel_learning();
  EXPECT_TRUE(rest.is_ready());
  EXPECT_FALSE(rest.is_relearning());
  EXPECT_EQ(rest.image()[0], 16 * 9);
  rest.restart(1);
  EXPECT_TRUE(rest.add(view({4, 4, 4, 4, 4, 4})));
  EXPECT_EQ(rest.image()[0], 16 * 4) << "of what was given up nothing is left";
}

// The light is followed while another image is learned, with what the image in force is divided by, and after it is
// given up.
TEST(Rest, LearningAnotherImageChangesNothingOfTheOneInForce) {
  constexpr int kWidth = 40;
  constexpr int kHeight = 32;
  std::vector<uint16_t> image(size_t{3} * kWidth * kHeight);
  for (size_t i = 0; i < image.size(); ++i) image[i] = static_cast<uint16_t>(i * 7 % 4081);
  const std::vector<uint16_t> dark(image.size(), 300);
  Rest kept(kWidth, kHeight, 1);
  Rest learning(kWidth, kHeight, 3);
  const auto expect_same = [&](const char* when) {
    EXPECT_TRUE(std::equal(kept.planes8().begin(), kept.planes8().end(), learning.planes8().begin())) << when;
    EXPECT_TRUE(std::equal(kept.reciprocal().begin(), kept.reciprocal().end(), learning.reciprocal().begin())) << when;
    EXPECT_TRUE(std::equal(kept.image().begin(), kept.image().end(), learning.image().begin())) << when;
  };
  for (Rest* rest : {&kept, &learning}) {
    rest->set_dark(dark);
    rest->load(image);
  }
  const std::vector<uint8_t> bright(image.size(), 255);
  learning.restart(3);
  EXPECT_FALSE(learning.add({bright.data(), kWidth, kHeight, 3, ptrdiff_t{3} * kWidth}));
  for (Rest* rest : {&kept, &learning}) rest->set_gain({Rest::kUnitGain * 11 / 10, Rest::kUnitGain, 1 << 19});
  expect_same("while it is learned");
  std::vector<int32_t> factor(size_t{3} * static_cast<size_t>(Rest::map_nodes(kWidth, kHeight).count()));
  for (size_t i = 0; i < factor.size(); ++i) factor[i] = Rest::kUnitGain + static_cast<int32_t>(i) * 1'000;
  for (Rest* rest : {&kept, &learning}) {
    rest->set_map(factor);
    for (int i = 0; i < 8; ++i) rest->advance();
  }
  expect_same("half of a map");
  learning.cancel_learning();
  for (Rest* rest : {&kept, &learning}) {
    for (int i = 8; i < 16; ++i) rest->advance();
  }
  expect_same("given up");
  for (Rest* rest : {&kept, &learning}) rest->set_gain({Rest::kUnitGain * 9 / 10, Rest::kUnitGain, Rest::kUnitGain});
  expect_same("after it");
}

TEST(Rest, LoadedImageIsInForceAtOnce) {
  Rest rest(2, 1, 4);
  const std::vector<uint16_t> stored = {16, 32, 48, 64, 80, 4080};
  rest.load(stored);
  EXPECT_TRUE(rest.is_ready());
  EXPECT_TRUE(std::equal(stored.begin(), stored.end(), rest.image().begin()));
}

TEST(Rest, OnlyWhatIsNotDarkIsOfTheLamps) {
  Rest rest(2, 1, 1);
  const std::vector<uint16_t> dark = {16 * 36, 0, 16 * 200, 16 * 5, 16 * 5, 16 * 5};
  rest.set_dark(dark);
  ASSERT_TRUE(rest.add(view({100, 100, 100, 69, 5, 0})));
  // Of 64 and 64 grey levels; darker than the dark frame is nothing, which counts as 32.
  EXPECT_EQ(rest.reciprocal()[0], 16'384);
  EXPECT_EQ(rest.reciprocal()[1], 16'384);
  EXPECT_EQ(rest.reciprocal()[4], 32'767);
  EXPECT_EQ(rest.planes8()[0], 8 * 1'600);
  rest.set_gain({Rest::kUnitGain * 5 / 4, Rest::kUnitGain, Rest::kUnitGain});
  EXPECT_EQ(rest.planes8()[0], 8 * 16 * (36 + 80));
  EXPECT_EQ(rest.planes8()[1], 8 * 16 * (5 + 80));
  EXPECT_EQ(rest.planes8()[2], 8 * 1'600);
  rest.set_dark({});
  EXPECT_EQ(rest.reciprocal()[0], 10'486);  // 2^24 / 1600
}

// Each pixel lies between two nodes each way.
TEST(Rest, AMapEndsBeyondTheLastPixel) {
  for (int size = 1; size <= 3 * Rest::kNodePx + 1; ++size) {
    const GridSize nodes = Rest::map_nodes(size, 1);
    EXPECT_GT((nodes.n_x - 1) * Rest::kNodePx, size - 1) << size;
    EXPECT_LE((nodes.n_x - 2) * Rest::kNodePx, size - 1) << size;
    EXPECT_EQ(nodes.n_y, 2);
  }
}

TEST(Rest, AMapCountsRowByRowAndOneOfUnitFactorsChangesNothing) {
  constexpr int kWidth = 40;
  constexpr int kHeight = 32;
  Rest rest(kWidth, kHeight, 1);
  rest.load(std::vector<uint16_t>(size_t{3} * kWidth * kHeight, 1600));
  const GridSize nodes = Rest::map_nodes(kWidth, kHeight);
  EXPECT_EQ(nodes, (GridSize{4, 3}));
  const std::vector<int16_t> before(rest.planes8().begin(), rest.planes8().end());
  std::vector<int32_t> factor(size_t{3} * 12, Rest::kUnitGain);
  rest.set_map(factor);
  for (int i = 0; i < 16; ++i) rest.advance();
  EXPECT_TRUE(std::equal(before.begin(), before.end(), rest.planes8().begin()));
  for (size_t i = 0; i < 12; ++i) factor[i] += static_cast<int32_t>(i % 4) * Rest::kUnitGain / 100;  // 1 % a node, of B
  rest.set_map(factor);
  rest.advance();
  EXPECT_EQ(rest.planes8()[39], 12'800 + 312) << "39 / 16 %";
  EXPECT_EQ(rest.planes8()[2 * kWidth + 39], 12'800) << "a 16th of the rows";
  for (int i = 1; i < 16; ++i) rest.advance();
  EXPECT_EQ(rest.planes8()[31 * kWidth + 8], 12'864);
  EXPECT_EQ(rest.planes8()[kWidth * kHeight + 39], 12'800) << "not of G";
  EXPECT_NEAR(rest.reciprocal()[31 * kWidth + 32], 10'486 / 1.02, 1);
}

}  // namespace
}  // namespace ruffini
