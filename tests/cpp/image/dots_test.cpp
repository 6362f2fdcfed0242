#include "image/dots.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "support/dot_picture.h"
#include "support/test_board.h"

namespace ruffini {
namespace {

using test::DotPicture;
using test::Place;

// Nominal dots of the board, each moved by its own fraction of a pixel.
std::vector<Place> scattered_dots(unsigned seed) {
  std::vector<Place> dots = test::nominal_dots(test::round_board());
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> shift(-1, 1);
  for (Place& dot : dots) dot = {dot.x + shift(random), dot.y + shift(random)};
  return dots;
}

// RMS distance along one axis from each true centre to the nearest detected one.
double rms_error_px(std::span<const Dot> found, const std::vector<Place>& truth) {
  double sum = 0;
  for (const Place& place : truth) {
    double best = 1e9;
    for (const Dot& dot : found) {
      best =
          std::min(best, std::pow(dot.x.raw() / 65536.0 - place.x, 2) + std::pow(dot.y.raw() / 65536.0 - place.y, 2));
    }
    sum += best / 2;
  }
  return std::sqrt(sum / static_cast<double>(truth.size()));
}

TEST(DotDetector, CentresAreGoodToThreeHundredthsOfAPixel) {
  DotDetector detector(dot_parameters(test::round_board()));
  for (const double noise : {0.0, 1.0}) {
    const std::vector<Place> truth = scattered_dots(1);
    const auto found = detector.detect(DotPicture{.noise = noise}.grey(truth, 2));
    EXPECT_EQ(found.size(), truth.size());
    EXPECT_LT(rms_error_px(found, truth), 0.03) << "noise " << noise;
    EXPECT_GT(rms_error_px(found, truth), 0.001) << "too good to be true: is the test comparing something with itself?";
  }
}

TEST(DotDetector, FindsLightDotsOnADarkPad) {
  BoardSettings board = test::round_board();
  board.markers.polarity = Polarity::kLight;
  DotDetector detector(dot_parameters(board));
  const std::vector<Place> truth = scattered_dots(3);
  const auto found = detector.detect(DotPicture{.level = 90, .contrast = -0.9}.grey(truth, 4));
  EXPECT_EQ(found.size(), truth.size());
  EXPECT_LT(rms_error_px(found, truth), 0.03);
}

TEST(DotDetector, SeesNothingOnAnUnprintedPad) {
  DotDetector detector(dot_parameters(test::round_board()));
  EXPECT_TRUE(detector.detect(DotPicture{.gradient = 1.2, .noise = 2}.grey({}, 5)).empty());
}

TEST(DotDetector, DropsTornMergedAndTinySpots) {
  DotDetector detector(dot_parameters(test::round_board()));
  const DotPicture picture{.noise = 0};
  EXPECT_TRUE(detector.detect(picture.grey({{1.5, 60}}, 0)).empty()) << "torn by the border";
  EXPECT_TRUE(detector.detect(picture.grey({{60, 60}, {65, 60}, {70, 60}, {75, 60}}, 0)).empty()) << "merged";
  EXPECT_TRUE(detector.detect(DotPicture{.diameter_px = 1.5, .noise = 0}.grey({{60, 60}}, 0)).empty()) << "dust";
  EXPECT_EQ(detector.detect(picture.grey({{60, 60}}, 0)).size(), 1U);
}

}  // namespace
}  // namespace ruffini
