#include "capture/pixels.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

namespace ruffini {
namespace {

constexpr int kWidth = 34;  // rows longer than the picture, so that strides count
constexpr int kHeight = 6;
constexpr int kStride = 160;

std::vector<uint8_t> noise(size_t n) {
  std::mt19937 random(7);
  std::vector<uint8_t> bytes(n);
  for (uint8_t& byte : bytes) byte = static_cast<uint8_t>(16 + random() % 240);  // OpenCV cuts off Y below black
  return bytes;
}

cv::Mat converted(PixelLayout layout, const YuvRule& rule, const RawFrame& frame) {
  cv::Mat out(kHeight, kWidth, CV_8UC3);
  to_bgr(layout, rule, frame, kWidth, kHeight, out.data);
  return out;
}

// Largest difference from OpenCV's conversion of the same bytes.
int difference(const cv::Mat& ours, const cv::Mat& packed, int code) {
  cv::Mat theirs;
  cv::cvtColor(packed, theirs, code);
  return static_cast<int>(cv::norm(ours, theirs, cv::NORM_INF));
}

TEST(Pixels, OrdersOfChannels) {
  const std::vector<uint8_t> bytes = noise(size_t{kStride} * kHeight);
  const RawFrame frame{{bytes.data(), nullptr}, {kStride, 0}};
  void* data = const_cast<uint8_t*>(bytes.data());
  const cv::Mat three(kHeight, kWidth, CV_8UC3, data, kStride);
  EXPECT_EQ(cv::norm(converted(PixelLayout::kBgr, kFull601, frame), three, cv::NORM_INF), 0);
  EXPECT_EQ(difference(converted(PixelLayout::kRgb, kFull601, frame), three, cv::COLOR_RGB2BGR), 0);
  const cv::Mat one(kHeight, kWidth, CV_8UC1, data, kStride);
  EXPECT_EQ(difference(converted(PixelLayout::kGrey, kFull601, frame), one, cv::COLOR_GRAY2BGR), 0);
  const cv::Mat four(kHeight, kWidth, CV_8UC4, data, kStride);
  EXPECT_EQ(difference(converted(PixelLayout::kBgrx, kFull601, frame), four, cv::COLOR_BGRA2BGR), 0);
}

TEST(Pixels, LimitedRangeIsAsOpenCvConverts) {
  const std::vector<uint8_t> bytes = noise(size_t{kStride} * kHeight * 2);
  void* data = const_cast<uint8_t*>(bytes.data());
  const RawFrame yuyv{{bytes.data(), nullptr}, {kStride, 0}};
  const cv::Mat two(kHeight, kWidth, CV_8UC2, data, kStride);
  EXPECT_LE(difference(converted(PixelLayout::kYuyv, kLimited601, yuyv), two, cv::COLOR_YUV2BGR_YUYV), 1);
  const RawFrame nv12{{bytes.data(), bytes.data() + ptrdiff_t{kStride} * kHeight}, {kStride, kStride}};
  const cv::Mat planes(kHeight * 3 / 2, kWidth, CV_8UC1, data, kStride);
  EXPECT_LE(difference(converted(PixelLayout::kNv12, kLimited601, nv12), planes, cv::COLOR_YUV2BGR_NV12), 1);
}

// B, G, R of one Y, U, V.
std::vector<int> colour(const YuvRule& rule, uint8_t y, uint8_t u, uint8_t v) {
  const std::vector<uint8_t> bytes = {y, u, y, v};
  std::vector<uint8_t> out(6);
  to_bgr(PixelLayout::kYuyv, rule, {{bytes.data(), nullptr}, {4, 0}}, 2, 1, out.data());
  return {out[0], out[1], out[2]};
}

TEST(Pixels, RangesAndPrimaries) {
  EXPECT_EQ(colour(kFull601, 77, 128, 128), (std::vector<int>{77, 77, 77}));
  EXPECT_EQ(colour(kLimited601, 16, 128, 128), (std::vector<int>{0, 0, 0}));
  EXPECT_EQ(colour(kLimited601, 235, 128, 128), (std::vector<int>{255, 255, 255}));
  // Pure red, by the standards' own numbers: Y 76, U 85, V 255 (601, full); Y 63, U 102, V 240 (709, limited).
  EXPECT_EQ(colour(kFull601, 76, 85, 255), (std::vector<int>{0, 0, 254}));
  const std::vector<int> red = colour(kLimited709, 63, 102, 240);
  EXPECT_LE(std::abs(red[0]) + std::abs(red[1]) + std::abs(red[2] - 255), 3);
  EXPECT_EQ(colour(kFull709, 54, 99, 255), (std::vector<int>{0, 0, 254}));
}

}  // namespace
}  // namespace ruffini
