#include "image/dots.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "image/kernels.h"
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

// The weights of dots.h, each from its own box.
std::vector<int16_t> weights_of(const DotParameters& p, const std::vector<uint16_t>& grey, size_t stride) {
  std::vector<int16_t> out(stride * static_cast<size_t>(p.height_px));
  for (int y = 0; y < p.height_px; ++y) {
    for (int x = 0; x < p.width_px; ++x) {
      int64_t sum = 0, area = 0;
      for (int v = std::max(y - p.box_radius_px, 0); v <= std::min(y + p.box_radius_px, p.height_px - 1); ++v) {
        for (int u = std::max(x - p.box_radius_px, 0); u <= std::min(x + p.box_radius_px, p.width_px - 1); ++u) {
          sum += grey[static_cast<size_t>(v * p.width_px + u)];
          ++area;
        }
      }
      const int64_t inverse = ((int64_t{1} << 33) + area) / (2 * area);
      const int64_t background = (sum * inverse + (int64_t{1} << 31)) >> 32;
      const int64_t darker = background - grey[static_cast<size_t>(y * p.width_px + x)];
      const int64_t contrast = p.polarity == Polarity::kLight ? -darker : darker;
      const int64_t weight = contrast - (background * (p.threshold_1e3 * 32'768 / 1'000) >> 15);
      out[static_cast<size_t>(y) * stride + static_cast<size_t>(x)] =
          static_cast<int16_t>(std::max<int64_t>(weight, 0));
    }
  }
  return out;
}

struct Picture {
  DotParameters parameters;
  std::vector<uint16_t> grey;
};

// Plain, with dots, with steps of light, noise: of any size, so that tiles are cut, and boxes are smaller than tiles.
std::vector<Picture> any_pictures() {
  std::mt19937 random(3);  // NOLINT: the same numbers on every run
  const auto below = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
  std::vector<Picture> out;
  for (int i = 0; i < 120; ++i) {
    DotParameters p{.width_px = 9 + below(90),
                    .height_px = 9 + below(70),
                    .box_radius_px = 2 + below(i % 3 == 0 ? 6 : 30),
                    .threshold_1e3 = 10 + below(i % 2 == 0 ? 200 : 890),
                    .polarity = i % 4 < 2 ? Polarity::kDark : Polarity::kLight,
                    .min_area_px = 1,
                    .max_area_px = 1'000};
    if (p.polarity == Polarity::kLight && i % 5 == 0) p.threshold_1e3 = 1'900;
    const int level = i % 7 == 0 ? 12'240 : i % 7 == 1 ? 0 : 600 + below(8'000);
    const int noise = i % 3 == 1 ? 1 : 1 + below(400);
    std::vector<int> grey(static_cast<size_t>(p.width_px * p.height_px), level);
    for (int n = below(6); n > 0; --n) {  // spots and steps
      const int left = below(p.width_px), top = below(p.height_px), side = 1 + below(n % 2 == 0 ? 6 : 40);
      const int by = below(2 * level + 2) - level;
      for (int y = top; y < std::min(top + side, p.height_px); ++y) {
        for (int x = left; x < std::min(left + side, p.width_px); ++x)
          grey[static_cast<size_t>(y * p.width_px + x)] += by;
      }
    }
    std::vector<uint16_t> levels;
    for (const int v : grey) levels.push_back(static_cast<uint16_t>(std::clamp(v + below(noise), 0, 12'240)));
    out.push_back({p, std::move(levels)});
  }
  return out;
}

TEST(DotTiles, AClosedTileHoldsNoWeight) {
  size_t n_closed = 0;
  for (const Picture& picture : any_pictures()) {
    const DotParameters& p = picture.parameters;
    const auto stride = static_cast<size_t>(p.width_px);
    const std::vector<int16_t> weight = weights_of(p, picture.grey, stride);
    DotTiles tiles(p, kernels::fastest_supported().dots.tiles);
    tiles.measure(picture.grey);
    tiles.measure(picture.grey);  // what the first picture left behind does not matter
    for (int y = 0; y < p.height_px; ++y) {
      const int row = y / DotTiles::kSide;
      for (int x = 0; x < p.width_px; ++x) {
        const bool is_open = tiles.open_tiles(row)[x / DotTiles::kSide] != 0;
        ASSERT_TRUE(is_open || weight[static_cast<size_t>(y) * stride + static_cast<size_t>(x)] == 0) << x << ", " << y;
        ASSERT_TRUE(!is_open || tiles.has_open_tile(row));
        n_closed += is_open ? 0 : 1;
      }
    }
  }
  EXPECT_GT(n_closed, 100'000U);
}

TEST(DotTiles, DotsAreThoseOfAllPixels) {
  size_t n_dots = 0;
  for (const Picture& picture : any_pictures()) {
    const DotParameters& p = picture.parameters;
    Blobs blobs(p.width_px, p.height_px);
    const size_t stride = blobs.row();
    const std::vector<int16_t> weight = weights_of(p, picture.grey, stride);
    blobs.start();
    for (int y = 0; y < p.height_px; ++y) {
      blobs.add(std::span<const int16_t>(weight).subspan(static_cast<size_t>(y) * stride, stride), y);
    }
    DotDetector detector(p);
    detector.detect(picture.grey);
    const std::span<const Dot> found = detector.detect(picture.grey);
    size_t n = 0;
    for (size_t i = 0; i < blobs.all().size(); ++i) {
      const Blob& blob = blobs.all()[i];
      if (blob.parent != static_cast<int>(i) || blob.touches_border || blob.area > p.max_area_px) continue;
      ASSERT_LT(n, found.size());
      EXPECT_EQ(found[n].x.raw(), (blob.weight_x << 16) / blob.weight);
      EXPECT_EQ(found[n].y.raw(), (blob.weight_y << 16) / blob.weight);
      EXPECT_EQ(found[n].area_px, blob.area);
      ++n;
    }
    EXPECT_EQ(n, found.size());
    n_dots += n;
  }
  EXPECT_GT(n_dots, 1'000U);
}

// Most tiles must be closed, or passing over them saves nothing.
TEST(DotTiles, MostOfAPictureWithDotsIsClosed) {
  BoardSettings board = test::round_board();
  const DotParameters p = dot_parameters(board);
  DotTiles tiles(p, kernels::fastest_supported().dots.tiles);
  const std::vector<Place> dots = scattered_dots(1);
  tiles.measure(DotPicture{}.grey({dots.begin(), dots.begin() + 12}, 2));
  int n_open = 0, n = 0;
  for (int row = 0; row < tiles.n_rows(); ++row) {
    for (int x = 0; x < p.width_px; x += DotTiles::kSide, ++n)
      n_open += tiles.open_tiles(row)[x / DotTiles::kSide] != 0;
  }
  EXPECT_GE(n_open, 12);
  EXPECT_LT(n_open, n / 3);
}

}  // namespace
}  // namespace ruffini
