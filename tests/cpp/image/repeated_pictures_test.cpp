#include "image/repeated_pictures.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace ruffini {
namespace {

using Pixels = std::vector<uint8_t>;
constexpr int kWidth = 320;
constexpr int kHeight = 240;

// A smooth picture with a noise of one grey level, each of its own.
Pixels noisy(unsigned seed) {
  std::minstd_rand lot(seed);
  std::normal_distribution<double> noise;
  Pixels pixels(size_t{3} * kWidth * kHeight);
  for (size_t i = 0; i < pixels.size(); ++i) {
    pixels[i] = static_cast<uint8_t>(std::lround(80 + static_cast<double>(i % 960) / 16 + noise(lot)));
  }
  return pixels;
}

class RepeatedPicturesTest : public testing::Test {
 protected:
  bool see(const Pixels& pixels) { return old_.run({pixels.data(), kWidth, kHeight, 3, ptrdiff_t{3} * kWidth}); }
  void rest(const Pixels& pixels) {
    see(pixels);
    old_.count_as_rest();
  }
  // `now` with rows from `first` on, and columns from `left` on, of `old`.
  static Pixels torn(Pixels now, const Pixels& old, int first, int left = 0, int right = kWidth, int last = kHeight) {
    for (int y = first; y < last; ++y) {
      const auto at = ptrdiff_t{3} * (y * kWidth + left);
      std::copy_n(old.begin() + at, 3 * (right - left), now.begin() + at);
    }
    return now;
  }

  RepeatedPictures old_{kWidth, kHeight};
};

TEST_F(RepeatedPicturesTest, NothingIsSaidOfNewPictures) {
  for (unsigned seed = 1; seed <= 100; ++seed) EXPECT_FALSE(see(noisy(seed))) << seed;
}

TEST_F(RepeatedPicturesTest, APictureOfTheLastThirtyOneIsOld) {
  for (unsigned seed = 1; seed <= 31; ++seed) EXPECT_FALSE(see(noisy(seed)));
  EXPECT_TRUE(see(noisy(1))) << "31 ago";
  EXPECT_TRUE(see(noisy(31))) << "2 ago";
  EXPECT_TRUE(see(noisy(31))) << "the last";
  EXPECT_FALSE(see(noisy(2))) << "33 ago";
  EXPECT_FALSE(see(noisy(32)));
}

TEST_F(RepeatedPicturesTest, APartOfAnOlderPictureIsOld) {
  const Pixels first = noisy(1);
  EXPECT_FALSE(see(first));
  unsigned seed = 2;
  for (int y = 0; y + 15 <= kHeight; ++y) {
    EXPECT_TRUE(see(torn(noisy(seed++), first, y, 0, kWidth, y + 15))) << y;
    if (seed % 20 == 0) (void)see(first);
  }
  EXPECT_TRUE(see(torn(noisy(1000), first, 0, 0, kWidth / 2))) << "the left one of two views";
  EXPECT_TRUE(see(torn(noisy(1001), first, 0, kWidth / 2)));
  EXPECT_FALSE(see(torn(noisy(1002), first, 236))) << "less than a band";
}

// As a fingertip's dark cells: with fewer pixels in a hash, some repeat among the rest frames, and parts are not
// judged.
TEST_F(RepeatedPicturesTest, APartIsOldWhereTheRestIsDarkAndQuiet) {
  const auto quiet = [](unsigned seed) {
    std::minstd_rand lot(seed);
    std::normal_distribution<double> noise(4, 0.33);
    Pixels pixels(size_t{3} * kWidth * kHeight);
    for (uint8_t& level : pixels) level = static_cast<uint8_t>(std::lround(noise(lot)));
    return pixels;
  };
  old_.begin_rest();
  for (unsigned seed = 1; seed <= 8; ++seed) rest(quiet(seed));
  EXPECT_FALSE(see(quiet(9)));
  EXPECT_TRUE(see(torn(quiet(10), quiet(9), 60)));
}

TEST_F(RepeatedPicturesTest, ACellThatRepeatsAloneIsNotJudgedUntilTheNextRest) {
  old_.begin_rest();
  for (unsigned seed = 1; seed <= 8; ++seed) rest(noisy(seed));
  const Pixels first = noisy(9);
  EXPECT_FALSE(see(first));
  EXPECT_FALSE(see(torn(noisy(10), first, 0, 0, kWidth / 4, 8))) << "one cell: perhaps by chance";
  EXPECT_FALSE(see(torn(noisy(11), first, 0, 0, kWidth / 4, 16))) << "that one and another";
  EXPECT_FALSE(see(torn(noisy(12), first, 0, 0, kWidth / 4, 16))) << "both are quiet now";
  EXPECT_TRUE(see(torn(noisy(13), first, 0, 0, kWidth / 4, 32))) << "two others";
  EXPECT_TRUE(see(first)) << "a whole one";
  old_.begin_rest();
  for (unsigned seed = 20; seed <= 28; ++seed) rest(noisy(seed));
  EXPECT_TRUE(see(torn(noisy(30), noisy(28), 0, 0, kWidth / 4, 16)));
}

TEST_F(RepeatedPicturesTest, BlackAndWhitePartsRepeatThemselvesWithoutAFault) {
  for (const uint8_t level : {uint8_t{0}, uint8_t{255}}) {
    const Pixels flat(size_t{3} * kWidth * kHeight, level);
    (void)see(flat);
    EXPECT_FALSE(see(flat)) << int{level};
    EXPECT_FALSE(see(torn(noisy(level + 1U), flat, 120)));
    EXPECT_FALSE(see(torn(noisy(level + 2U), flat, 120)));
  }
}

TEST_F(RepeatedPicturesTest, OfACameraWithoutNoiseOnlyWholePicturesAreOld) {
  const Pixels still = noisy(1);
  old_.begin_rest();
  rest(still);
  rest(still);
  EXPECT_TRUE(see(still));
  EXPECT_FALSE(see(torn(noisy(2), still, 120))) << "a touch on half of it";
  EXPECT_TRUE(see(still));
  old_.begin_rest();
  rest(noisy(3));
  rest(noisy(4));
  EXPECT_TRUE(see(torn(noisy(5), still, 120)));
}

TEST_F(RepeatedPicturesTest, ARestOfOneFrameTellsNothingOfTheCamerasNoise) {
  const Pixels still = noisy(1);
  old_.begin_rest();
  rest(still);
  EXPECT_FALSE(see(torn(noisy(2), still, 120))) << "perhaps a touch on half of it";
  EXPECT_TRUE(see(still)) << "a whole one is old all the same";
  old_.begin_rest();
  rest(noisy(3));  // older ones were compared
  EXPECT_TRUE(see(torn(noisy(4), still, 120)));
}

}  // namespace
}  // namespace ruffini
