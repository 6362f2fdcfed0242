#include "image/frame_watch.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <random>

#include "support/dot_picture.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

using Pixels = std::vector<uint8_t>;
using Verdict = FrameWatch::Defects;

// The round board's pad with a noise of one grey level, and what can happen to its picture.
class FrameWatchTest : public testing::Test {
 protected:
  FrameWatchTest() : dots_(test::nominal_dots(board_)), watch_(width_, height_) {
    std::vector<uint16_t> rest;
    for (const uint8_t value : test::DotPicture{.noise = 0}.bgr(dots_, 1)) {
      rest.push_back(static_cast<uint16_t>(16 * value));
    }
    watch_.learn(rest);
  }
  Pixels picture(unsigned seed, double shift_px = 0, double noise = 1) const {
    auto dots = dots_;
    for (test::Place& dot : dots) {
      dot.x += shift_px;
      dot.y += shift_px;
    }
    return test::DotPicture{.noise = noise}.bgr(dots, seed);
  }
  Verdict see(const Pixels& pixels) { return watch_.run({pixels.data(), width_, height_, 3, ptrdiff_t{3} * width_}); }
  auto row(Pixels& pixels, int y) const { return pixels.begin() + ptrdiff_t{3} * width_ * y; }

  BoardSettings board_ = test::round_board();
  int width_ = board_.camera.width_px;
  int height_ = board_.camera.height_px;
  std::vector<test::Place> dots_;
  FrameWatch watch_;
};

TEST_F(FrameWatchTest, NothingIsSaidOfGoodPictures) {
  for (unsigned seed = 1; seed <= 200; ++seed) {
    const Verdict seen = see(picture(seed, seed % 5, seed % 2 == 0 ? 1 : 4));
    EXPECT_FALSE(seen.is_broken || seen.is_light_wrong) << seed;
  }
}

TEST_F(FrameWatchTest, AMissingRowAnywhereIsSeen) {
  for (int y = 0; y < height_; ++y) {
    for (const uint8_t level : {uint8_t{0}, uint8_t{255}}) {
      Pixels pixels = picture(3);
      std::fill(row(pixels, y), row(pixels, y + 1), level);
      EXPECT_TRUE(see(pixels).is_broken) << y << " " << int{level};
    }
  }
}

TEST_F(FrameWatchTest, AMissingColumnAnywhereIsSeenAndAMissingSide) {
  const size_t width = static_cast<size_t>(width_);
  for (size_t x = 0; x < width; ++x) {
    for (const uint8_t level : {uint8_t{0}, uint8_t{255}}) {
      for (const size_t end : {x + 1, width}) {
        if (end == width && (x == 0 || level != 0)) continue;
        Pixels pixels = picture(7);
        for (size_t i = 0; i < pixels.size(); ++i) {
          if (i / 3 % width >= x && i / 3 % width < end) pixels[i] = level;
        }
        EXPECT_TRUE(see(pixels).is_broken) << x << " " << int{level} << " " << end;
      }
    }
  }
}

TEST_F(FrameWatchTest, AMissingPartOfThePictureIsSeen) {
  for (int y = 1; y < height_; ++y) {
    Pixels pixels = picture(4);
    std::fill(row(pixels, y), pixels.end(), uint8_t{0});
    EXPECT_TRUE(see(pixels).is_broken) << y;
  }
}

TEST_F(FrameWatchTest, ABandOfNoiseIsSeenWhereItIs) {
  std::mt19937 random(5);
  for (int y = 0; y + 24 <= height_; y += 8) {
    Pixels pixels = picture(5);
    std::generate(row(pixels, y), row(pixels, y + 24), [&] { return static_cast<uint8_t>(random() % 256); });
    EXPECT_TRUE(see(pixels).is_broken) << y;
  }
}

TEST_F(FrameWatchTest, AChannelWithoutItsLampIsSeenAndAFewPercentAreNot) {
  for (size_t c = 0; c < 3; ++c) {
    for (const int percent : {20, 45, 90, 130, 205}) {
      Pixels pixels = picture(6);
      for (size_t i = c; i < pixels.size(); i += 3) {
        pixels[i] = static_cast<uint8_t>(std::min(255, pixels[i] * percent / 100));
      }
      const Verdict seen = see(pixels);
      EXPECT_EQ(seen.is_light_wrong, percent < 50 || percent > 200) << c << " " << percent;
    }
  }
}

TEST_F(FrameWatchTest, AnOffsetOfAllLevelsIsSeenAndNoiseIsNot) {
  const Pixels rest = picture(7);
  const int mean = static_cast<int>(std::accumulate(rest.begin(), rest.end(), int64_t{0}) / std::ssize(rest));
  for (const int percent : {-40, -20, 0, 20, 40}) {
    Pixels pixels = rest;
    for (uint8_t& level : pixels) level = static_cast<uint8_t>(std::clamp(level + mean * percent / 100, 0, 255));
    EXPECT_EQ(see(pixels).is_level_off, std::abs(percent) > 25) << percent;
  }
}

}  // namespace
}  // namespace ruffini
