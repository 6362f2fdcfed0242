#include "capture/png.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>

namespace ruffini {
namespace {

constexpr int kWidth = 37;
constexpr int kHeight = 21;
constexpr size_t kMaxPixels = kWidth * kHeight;

cv::Mat noise(int type) {
  cv::Mat made(kHeight, kWidth, type);
  cv::RNG random(3);
  random.fill(made, cv::RNG::UNIFORM, 0, made.depth() == CV_16U ? 65'536 : 256);
  return made;
}

std::vector<uint8_t> encoded(const cv::Mat& image, const std::vector<int>& how = {}) {
  std::vector<uint8_t> bytes;
  cv::imencode(".png", image, bytes, how);
  return bytes;
}

bool decodes(const std::vector<uint8_t>& bytes, std::vector<uint8_t>& out, size_t max_pixels = kMaxPixels) {
  const PngSize size = decode_png(bytes, max_pixels, out);
  return size.width_px == kWidth && size.height_px == kHeight;
}

TEST(Png, IsAsOpenCvDecodes) {
  const std::vector<std::vector<int>> ways{{}, {cv::IMWRITE_PNG_BILEVEL, 1}};
  for (const int type : {CV_8UC1, CV_8UC3, CV_8UC4, CV_16UC1, CV_16UC3, CV_16UC4}) {
    for (const std::vector<int>& how : ways) {
      if (!how.empty() && type != CV_8UC1) continue;
      const std::vector<uint8_t> bytes = encoded(noise(type), how);
      std::vector<uint8_t> ours;
      ASSERT_TRUE(decodes(bytes, ours)) << type;
      const cv::Mat theirs = cv::imdecode(bytes, cv::IMREAD_COLOR);
      EXPECT_EQ(cv::norm(cv::Mat(kHeight, kWidth, CV_8UC3, ours.data()), theirs, cv::NORM_INF), 0) << type;
    }
  }
}

TEST(Png, TooManyPixelsAreRefused) {
  std::vector<uint8_t> ours;
  EXPECT_FALSE(decodes(encoded(noise(CV_8UC3)), ours, kMaxPixels - 1));
}

TEST(Png, EachTruncationIsNoPicture) {
  const std::vector<uint8_t> bytes = encoded(noise(CV_8UC3));
  std::vector<uint8_t> ours;
  for (size_t n = 0; n < bytes.size(); ++n) {
    EXPECT_FALSE(decodes({bytes.begin(), bytes.begin() + static_cast<ptrdiff_t>(n)}, ours)) << n;
  }
}

TEST(Png, DamageNeverCrashesAndIsRefusedInTheImageData) {
  const std::vector<uint8_t> bytes = encoded(noise(CV_8UC3));
  std::vector<uint8_t> ours;
  std::mt19937 random(5);
  for (int i = 0; i < 2'000; ++i) {
    std::vector<uint8_t> damaged = bytes;
    const size_t at = random() % damaged.size();
    damaged[at] = static_cast<uint8_t>(damaged[at] ^ (1 + random() % 255));
    const bool is_whole = decodes(damaged, ours);
    constexpr size_t kDataAt = 100;  // after the header and what OpenCV writes beside it
    if (at > kDataAt && at + 20 < damaged.size()) {
      EXPECT_FALSE(is_whole) << at;
    }
  }
}

}  // namespace
}  // namespace ruffini
