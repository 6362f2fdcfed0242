// The real capture code on libcamera's virtual pipeline: frames that libcamera makes up, memory and requests as on a
// board. The pipeline reads its cameras from one fixed file, so these tests run where that file lists them
// (firmware/deploy/README.md says how) and are skipped elsewhere.
#include "capture/libcamera_camera.h"

#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <optional>

#include "board/parse.h"
#include "capture/paired_camera.h"

namespace ruffini {
namespace {

constexpr const char* kCameras = "/usr/share/libcamera/pipeline/virtual/virtual.yaml";
constexpr int kWidth = 320;
constexpr int kHeight = 240;

class LibcameraTest : public testing::Test {
 protected:
  void SetUp() override {
    std::ifstream stream(kCameras);
    const std::string text(std::istreambuf_iterator<char>(stream), {});
    if (text.find("VirtualPad") == std::string::npos) GTEST_SKIP() << kCameras << " lists no VirtualPad";
    board_.camera.width_px = kWidth;
    board_.camera.height_px = kHeight;
    board_.camera.rate_mhz = 50'000;
  }

  // The first of 50 answers that is a frame.
  static std::optional<int> frame(Camera& camera, FramePool& pool) {
    const std::optional<int> index = pool.lend();
    for (int i = 0; index && i < 50; ++i) {
      if (camera.capture(pool[*index]) == CaptureStatus::kFrame) return index;
    }
    return std::nullopt;
  }

  BoardSettings board_;
  FramePool pool_{8, kWidth, kHeight};
};

TEST_F(LibcameraTest, FramesComeInColourAtTheBoardsRate) {
  auto camera = open_libcamera("VirtualPad", board_);
  ASSERT_TRUE(camera) << camera.error().message;
  EXPECT_TRUE(camera.value()->is_simulated());
  EXPECT_FALSE(camera.value()->is_replay());
  uint64_t before_us = 0;
  uint64_t number = 0;
  uint64_t first_us = 0;
  for (int i = 0; i < 8; ++i) {
    const std::optional<int> index = frame(*camera.value(), pool_);
    ASSERT_TRUE(index) << camera.value()->problem();
    const FramePool::Buffer& buffer = pool_[*index];
    EXPECT_GT(buffer.capture_us, before_us);
    before_us = buffer.capture_us;
    if (i == 0) first_us = before_us;
    if (i > 0) {
      EXPECT_EQ(buffer.number, number + 1);
    }
    number = buffer.number;
    // Three flat stripes: red, green, blue. Not exact: the pipeline calls a JPEG's full-range BT.601 limited BT.709.
    const auto at = [&](int x, int channel) {
      return int{buffer.pixels[static_cast<size_t>(3 * (kWidth * (kHeight / 2) + x) + channel)]};
    };
    for (int stripe = 0; stripe < 3; ++stripe) {
      for (int channel = 0; channel < 3; ++channel) {
        const int wanted = channel == 2 - stripe ? 200 : 40;
        EXPECT_NEAR(at(kWidth / 6 + stripe * kWidth / 3, channel), wanted, 40) << stripe << " " << channel;
      }
    }
  }
  // Seven intervals of 20 ms: the pipeline itself gives a thousand frames a second.
  EXPECT_GT(before_us - first_us, 100'000U);
}

TEST_F(LibcameraTest, OpensAgainAfterItWasClosed) {
  for (int i = 0; i < 3; ++i) {
    auto camera = open_libcamera("VirtualPad", board_);
    ASSERT_TRUE(camera) << camera.error().message;
    FramePool pool(2, kWidth, kHeight);
    EXPECT_TRUE(frame(*camera.value(), pool));
  }
}

// libcamera allows one manager in a process; the pipeline's stamps are those of the moments at which it was asked.
TEST_F(LibcameraTest, TwoCamerasAtOnceMakeOnePicture) {
  auto left = open_libcamera("VirtualPad", board_);
  ASSERT_TRUE(left) << left.error().message;
  auto right = open_libcamera("VirtualRight", board_);
  ASSERT_TRUE(right) << right.error().message;
  auto both = pair_cameras(std::move(left).value(), std::move(right).value(), 2 * kWidth, kHeight, 9'000);
  ASSERT_TRUE(both);
  FramePool pool(2, 2 * kWidth, kHeight);
  uint64_t before_us = 0;
  for (int i = 0; i < 8; ++i) {
    const std::optional<int> index = frame(*both.value(), pool);
    ASSERT_TRUE(index) << both.value()->problem();
    const FramePool::Buffer& buffer = pool[*index];
    EXPECT_GT(buffer.capture_us, before_us);
    before_us = buffer.capture_us;
    const size_t row = size_t{3} * 2 * kWidth * (kHeight / 2);
    const auto at = [&](size_t x, size_t channel) { return int{buffer.pixels[row + 3 * x + channel]}; };
    for (const size_t middle : {size_t{kWidth / 6}, size_t{kWidth + kWidth / 6}}) {  // red is at the left of each
      EXPECT_GT(at(middle, 2), at(middle, 0) + 80);
      EXPECT_LT(at(middle + 2 * kWidth / 3, 2), at(middle + 2 * kWidth / 3, 0) - 80);
    }
    pool.give_back(*index);
  }
}

TEST_F(LibcameraTest, WhatCannotBeIsRefusedWithItsReason) {
  const auto missing = open_libcamera("NoSuchCamera", board_);
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().kind, ErrorKind::kUnavailable);
  EXPECT_NE(missing.error().message.find("VirtualPad"), std::string::npos) << missing.error().message;

  const auto several = open_libcamera("Virtual", board_);
  ASSERT_FALSE(several);
  EXPECT_EQ(several.error().kind, ErrorKind::kBadInput);
  EXPECT_NE(several.error().message.find("--camera libcamera:NAME"), std::string::npos) << several.error().message;

  BoardSettings other = board_;
  other.camera.width_px = 500;
  const auto wrong = open_libcamera("VirtualPad", other);
  ASSERT_FALSE(wrong);
  EXPECT_EQ(wrong.error().kind, ErrorKind::kBadInput);
  EXPECT_NE(wrong.error().message.find("500x240"), std::string::npos) << wrong.error().message;

  other = board_;
  other.exposure = {4'000, 2'000, 1'500, 1'500};
  const auto fixed = open_libcamera("VirtualPad", other);
  ASSERT_FALSE(fixed);
  EXPECT_NE(fixed.error().message.find("ExposureTime"), std::string::npos) << fixed.error().message;
}

}  // namespace
}  // namespace ruffini
