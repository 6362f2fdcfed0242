// The capture code on a driver in memory: what it asks, what it makes of frames and of faults. No time is waited.
#include "capture/v4l2_camera.h"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <vector>

#include "support/fake_driver.h"

namespace ruffini {
namespace {

using test::FakeControl;
using test::FakeFrame;

constexpr uint32_t kWidth = 32;
constexpr uint32_t kHeight = 16;
constexpr int kPixels = 32 * 16;

class V4l2Camera : public testing::Test {
 protected:
  V4l2Camera() {
    board_.camera.width_px = kWidth;
    board_.camera.height_px = kHeight;
    board_.camera.rate_mhz = 50'000;
    driver_.modes = {{V4L2_PIX_FMT_YUYV, kWidth, kHeight, 50}};
  }

  void expose() {
    board_.exposure = {.time_us = 5'000, .gain_1e3 = 1'500, .white_kelvin = 5'000};
    driver_.controls = {{V4L2_CID_EXPOSURE_AUTO, FakeControl{0, 3, 3, V4L2_EXPOSURE_APERTURE_PRIORITY}},
                        {V4L2_CID_EXPOSURE_ABSOLUTE, FakeControl{1, 500, 156, 156}},
                        {V4L2_CID_EXPOSURE_AUTO_PRIORITY, FakeControl{0, 1, 0, 1}},
                        {V4L2_CID_GAIN, FakeControl{10, 80, 20, 20}},
                        {V4L2_CID_AUTO_WHITE_BALANCE, FakeControl{0, 1, 1, 1}},
                        {V4L2_CID_WHITE_BALANCE_TEMPERATURE, FakeControl{2'800, 6'500, 4'600, 4'600}}};
  }

  Result<std::unique_ptr<Camera>> open(const std::string& name = "") {
    return open_v4l2(name, board_, driver_.calls());
  }

  // The sentence with which it does not open.
  std::string refusal(ErrorKind kind, const std::string& name = "") {
    const auto camera = open(name);
    if (camera) return "it opened";
    EXPECT_EQ(camera.error().kind, kind) << camera.error().message;
    EXPECT_EQ(driver_.n_open, 0);
    EXPECT_EQ(driver_.n_mapped, 0);
    return camera.error().message;
  }

  // YUYV of one level of grey.
  static FakeFrame grey(uint8_t level, uint32_t sequence, uint64_t stamp_us) {
    FakeFrame frame{.sequence = sequence, .stamp_us = stamp_us};
    for (int i = 0; i < kPixels; ++i) frame.bytes.insert(frame.bytes.end(), {level, 128});
    return frame;
  }

  CaptureStatus capture(Camera& camera) { return camera.capture(pool_[0]); }

  test::FakeDriver driver_;
  BoardSettings board_;
  FramePool pool_{1, kWidth, kHeight};
};

TEST_F(V4l2Camera, FramesComeWithTheDriversStampsAndGaps) {
  const auto camera = open();
  ASSERT_TRUE(camera) << camera.error().message;
  EXPECT_FALSE(camera.value()->is_simulated());
  driver_.frames = {grey(16, 4, 1'000'000), grey(235, 5, 1'020'000), grey(16, 8, 1'080'000)};
  ASSERT_EQ(capture(*camera.value()), CaptureStatus::kFrame);
  EXPECT_EQ(pool_[0].pixels, std::vector<uint8_t>(3 * kPixels, 0)) << "limited range: 16 is black";
  EXPECT_EQ(pool_[0].capture_us, 1'000'000U) << "no [exposure]: its middle is not known";
  const uint64_t first = pool_[0].number;
  ASSERT_EQ(capture(*camera.value()), CaptureStatus::kFrame);
  EXPECT_EQ(pool_[0].pixels, std::vector<uint8_t>(3 * kPixels, 255));
  EXPECT_EQ(pool_[0].number, first + 1);
  ASSERT_EQ(capture(*camera.value()), CaptureStatus::kFrame);
  EXPECT_EQ(pool_[0].number, first + 4) << "two were lost in the driver";
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kNothing);
}

TEST_F(V4l2Camera, BuffersGoBackToTheDriver) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  for (uint32_t i = 0; i < 50; ++i) {  // of four buffers
    driver_.frames.push_back(grey(100, i, 1'000'000 + 20'000 * i));
    ASSERT_EQ(capture(*camera.value()), CaptureStatus::kFrame) << i;
  }
  driver_.is_burst = true;
  for (uint32_t i = 50; i < 53; ++i) driver_.frames.push_back(grey(static_cast<uint8_t>(i), i, 1'000'000 + 20'000 * i));
  ASSERT_EQ(capture(*camera.value()), CaptureStatus::kFrame);
  EXPECT_EQ(pool_[0].capture_us, 1'000'000U + 20'000 * 52) << "the newest of those that wait";
  for (uint32_t i = 53; i < 70; ++i) {
    driver_.frames.push_back(grey(100, i, 1'000'000 + 20'000 * i));
    ASSERT_EQ(capture(*camera.value()), CaptureStatus::kFrame) << i;
  }
}

TEST_F(V4l2Camera, EverythingIsGivenBackAtTheEnd) {
  {
    ASSERT_TRUE(open());
  }
  EXPECT_EQ(driver_.n_open, 0);
  EXPECT_EQ(driver_.n_mapped, 0);
}

TEST_F(V4l2Camera, StampsAreCarriedToTheMiddleOfTheExposure) {
  expose();
  const auto camera = open();
  ASSERT_TRUE(camera) << camera.error().message;
  for (uint32_t i = 0; i < 10; ++i) {
    driver_.frames.push_back(grey(100, i, 1'000'000 + 20'000 * i));
    ASSERT_EQ(capture(*camera.value()), CaptureStatus::kNothing) << "its controls may not be in force yet";
  }
  driver_.frames = {grey(100, 10, 2'000'000), grey(100, 11, 2'020'000), grey(100, 12, 2'040'000)};
  driver_.frames[1].flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_EOF;
  driver_.frames[2].flags = V4L2_BUF_FLAG_TIMESTAMP_UNKNOWN;
  ASSERT_EQ(capture(*camera.value()), CaptureStatus::kFrame);
  EXPECT_EQ(pool_[0].capture_us, 2'002'500U) << "from the start of exposure";
  ASSERT_EQ(capture(*camera.value()), CaptureStatus::kFrame);
  EXPECT_EQ(pool_[0].capture_us, 2'017'500U) << "from the end of the frame";
  ASSERT_EQ(capture(*camera.value()), CaptureStatus::kFrame);
  EXPECT_EQ(pool_[0].capture_us, 0U) << "another clock's: FrameOrder takes the time of arrival";
}

TEST_F(V4l2Camera, AutomaticsAreOffAndDriftMakesFramesInvalid) {
  expose();
  const auto camera = open();
  ASSERT_TRUE(camera) << camera.error().message;
  const auto set = [&](uint32_t id) { return driver_.controls.at(id).now; };
  EXPECT_EQ(set(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_MANUAL);
  EXPECT_EQ(set(V4L2_CID_EXPOSURE_ABSOLUTE), 50);
  EXPECT_EQ(set(V4L2_CID_EXPOSURE_AUTO_PRIORITY), 0);
  EXPECT_EQ(set(V4L2_CID_GAIN), 30) << "20 is 1, 80 is 4";
  EXPECT_EQ(set(V4L2_CID_AUTO_WHITE_BALANCE), 0);
  EXPECT_EQ(set(V4L2_CID_WHITE_BALANCE_TEMPERATURE), 5'000);
  uint32_t n = 0;
  const auto next = [&] {
    driver_.frames.push_back(grey(100, n, 1'000'000 + 20'000 * n));
    ++n;
    driver_.now += std::chrono::milliseconds{20};
    return capture(*camera.value());
  };
  while (n < 20) next();
  EXPECT_EQ(next(), CaptureStatus::kFrame);
  driver_.controls.at(V4L2_CID_EXPOSURE_ABSOLUTE).now = 60;
  int n_passed = 0;
  while (next() == CaptureStatus::kFrame) ++n_passed;
  EXPECT_LE(n_passed, 50) << "it is asked each second";
  driver_.controls.at(V4L2_CID_EXPOSURE_ABSOLUTE).now = 50;
  int n_invalid = 1;
  while (next() == CaptureStatus::kInvalidFrame) ++n_invalid;
  EXPECT_LE(n_invalid, 50);
  driver_.controls.at(V4L2_CID_GAIN).now = 31;
  CaptureStatus last = CaptureStatus::kFrame;
  for (int i = 0; i < 400 && last != CaptureStatus::kEnd; ++i) last = next();
  EXPECT_EQ(last, CaptureStatus::kEnd);
  EXPECT_NE(camera.value()->problem().find("has a gain of 31 in its own unit, 30 at the start: give [exposure]"),
            std::string::npos)
      << camera.value()->problem();
}

TEST_F(V4l2Camera, ExposureThatItCannotBeToldIsNamedWithItsLimits) {
  expose();
  board_.exposure.time_us = 60'000;
  board_.exposure.gain_1e3 = 8'000;
  board_.exposure.white_kelvin = 9'000;
  const std::string said = refusal(ErrorKind::kBadInput);
  EXPECT_NE(said.find("exposure.time_us = 60000, only 100 to 50000; exposure.gain_1e3 = 8000, only its own 10 to 80, "
                      "1000 being 20; exposure.white_kelvin = 9000, only 2800 to 6500: give [exposure]"),
            std::string::npos)
      << said;
  driver_.controls.erase(V4L2_CID_GAIN);
  EXPECT_NE(refusal(ErrorKind::kBadInput).find("; exposure.gain_1e3; "), std::string::npos);
  board_.exposure.white_kelvin = 0;
  board_.exposure.red_1e3 = board_.exposure.blue_1e3 = 2'000;
  EXPECT_NE(refusal(ErrorKind::kBadInput).find("give white_kelvin"), std::string::npos);
}

TEST_F(V4l2Camera, DamagedFramesAreInvalidAndTooManyEndIt) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  FakeFrame marked = grey(100, 0, 1'000'000);
  marked.flags |= V4L2_BUF_FLAG_ERROR;
  FakeFrame cut = grey(100, 1, 1'020'000);
  cut.bytes.pop_back();
  driver_.frames = {marked, cut, grey(100, 2, 1'040'000)};
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kInvalidFrame);
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kInvalidFrame);
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kFrame);
  for (int i = 0; i < 299; ++i) {
    driver_.frames = {cut};
    ASSERT_EQ(capture(*camera.value()), CaptureStatus::kInvalidFrame) << i;
  }
  driver_.frames = {cut};
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kEnd);
  EXPECT_NE(camera.value()->problem().find("only damaged frames: try another cable"), std::string::npos);
}

TEST_F(V4l2Camera, MotionJpegIsDecodedAndTornFramesAreInvalid) {
  driver_.modes = {{V4L2_PIX_FMT_MJPEG, kWidth, kHeight, 50}};
  const auto camera = open();
  ASSERT_TRUE(camera) << camera.error().message;
  FakeFrame whole{.sequence = 1, .stamp_us = 1'000'000};
  cv::imencode(".jpg", cv::Mat(kHeight, kWidth, CV_8UC3, cv::Scalar(40, 90, 200)), whole.bytes);
  FakeFrame torn = whole;
  torn.bytes.resize(torn.bytes.size() / 2);
  FakeFrame other{.sequence = 3, .stamp_us = 1'040'000};
  cv::imencode(".jpg", cv::Mat(kHeight, 2 * kWidth, CV_8UC3, cv::Scalar(40, 90, 200)), other.bytes);
  driver_.frames = {torn, other, FakeFrame{.sequence = 4}, whole};
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kInvalidFrame);
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kInvalidFrame) << "of another size";
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kInvalidFrame) << "empty";
  ASSERT_EQ(capture(*camera.value()), CaptureStatus::kFrame);
  EXPECT_NEAR(pool_[0].pixels[0], 40, 3);
  EXPECT_NEAR(pool_[0].pixels[2], 200, 3);
}

TEST_F(V4l2Camera, UnpluggedIsTheEnd) {
  for (const bool is_told : {true, false}) {
    driver_.is_gone = false;
    const auto camera = open();
    ASSERT_TRUE(camera);
    driver_.frames = {grey(100, 0, 1'000'000)};
    ASSERT_EQ(capture(*camera.value()), CaptureStatus::kFrame);
    if (is_told) {
      driver_.frames = {FakeFrame{.error = ENODEV}};
    } else {
      driver_.is_gone = true;
    }
    EXPECT_EQ(capture(*camera.value()), CaptureStatus::kEnd);
    EXPECT_EQ(camera.value()->problem(), "camera Test Cam (/dev/video0) was unplugged");
    EXPECT_EQ(capture(*camera.value()), CaptureStatus::kEnd);
  }
}

TEST_F(V4l2Camera, SilenceStartsItAgainThenEndsIt) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  const auto until_start = [&](int n) {
    while (driver_.n_starts < n && capture(*camera.value()) == CaptureStatus::kNothing) {
    }
    return driver_.n_starts;
  };
  EXPECT_EQ(until_start(2), 2);
  EXPECT_EQ(driver_.waited, std::chrono::seconds{1});
  driver_.frames = {grey(100, 0, 9'000'000)};
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kFrame) << "it goes on";
  driver_.waited = {};
  EXPECT_EQ(until_start(99), 5) << "three starts in vain";
  EXPECT_EQ(driver_.waited, std::chrono::seconds{1 + 2 + 4 + 8});
  EXPECT_NE(camera.value()->problem().find("gives no frames, though it was started again"), std::string::npos);
}

TEST_F(V4l2Camera, AnotherFaultOfTheDriverStartsItAgain) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  driver_.frames = {FakeFrame{.error = EIO}, grey(100, 0, 1'000'000)};
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kNothing);
  EXPECT_EQ(driver_.n_starts, 2);
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kFrame);
}

TEST_F(V4l2Camera, AChangeOfThePictureIsTheEnd) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  driver_.changes_size = true;
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kEnd);
  EXPECT_NE(camera.value()->problem().find("changed the size of its picture"), std::string::npos);
}

TEST_F(V4l2Camera, AFasterCameraIsTakenAtTheBoardsRate) {
  driver_.least_rate_hz = 80;
  driver_.modes[0].rate_hz = 80;
  const auto camera = open();
  ASSERT_TRUE(camera);
  int n = 0;
  uint64_t number = 0;
  for (uint32_t i = 0; i < 80; ++i) {  // a second
    driver_.frames.push_back(grey(100, i, 1'000'000 + 12'500 * i));
    if (capture(*camera.value()) != CaptureStatus::kFrame) continue;
    if (n > 0) {
      EXPECT_EQ(pool_[0].number, number + 1) << "those passed over are not missing";
    }
    number = pool_[0].number;
    ++n;
  }
  EXPECT_GE(n, 49);
  EXPECT_LE(n, 51);
}

TEST_F(V4l2Camera, TheNextFormatIsTakenWhereOneDoesNotStart) {
  driver_.modes = {{V4L2_PIX_FMT_MJPEG, kWidth, kHeight, 50}, {V4L2_PIX_FMT_YUYV, kWidth, kHeight, 50}};
  driver_.errors[VIDIOC_STREAMON] = {ENOSPC};
  const auto camera = open();
  ASSERT_TRUE(camera) << camera.error().message;
  FakeFrame frame{.sequence = 1, .stamp_us = 1'000'000};
  cv::imencode(".jpg", cv::Mat(kHeight, kWidth, CV_8UC3, cv::Scalar(40, 90, 200)), frame.bytes);
  driver_.frames = {frame};
  EXPECT_EQ(capture(*camera.value()), CaptureStatus::kFrame) << "YUYV has no room, so MJPG";
}

TEST_F(V4l2Camera, BadInputIsOneSentence) {
  const auto says = [this](ErrorKind kind, const char* words, const std::string& name = "") {
    const std::string said = refusal(kind, name);
    EXPECT_NE(said.find(words), std::string::npos) << said;
    EXPECT_EQ(said.find('\n'), std::string::npos);
  };
  says(ErrorKind::kUnavailable, "camera Nobody is not there: this computer has /dev/video0 (Test Cam", "Nobody");
  says(ErrorKind::kUnavailable, "camera /dev/video9 is not there: this computer has /dev/video0", "/dev/video9");
  driver_.open_error = EACCES;
  says(ErrorKind::kUnavailable, "may not be opened by this user: sudo usermod -aG video $USER");
  says(ErrorKind::kUnavailable, "may not be opened by this user", "/dev/video0");
  driver_.open_error = 0;
  for (const unsigned long call : {VIDIOC_S_FMT, VIDIOC_REQBUFS, VIDIOC_STREAMON}) {
    driver_.errors[call] = {EBUSY};
    says(ErrorKind::kUnavailable, "is used by another program: end that one (fuser /dev/video0)");
  }
  driver_.errors[VIDIOC_STREAMON] = {ENOSPC};
  says(ErrorKind::kUnavailable, "has no room on its USB bus for YUYV of that size and rate: give it a USB 3 port");
  driver_.given_width = 640;
  says(ErrorKind::kBadInput, "gives YUYV of 640x16 where YUYV of the board's size was asked");
  driver_.given_width = 0;
  driver_.field = V4L2_FIELD_INTERLACED;
  says(ErrorKind::kBadInput, "in interlaced fields");
  driver_.field = V4L2_FIELD_NONE;
  driver_.modes = {{V4L2_PIX_FMT_YUYV, 640, 480, 30}, {V4L2_PIX_FMT_MJPEG, 1280, 720, 30}};
  says(ErrorKind::kBadInput,
       "has no picture of that size: board.toml asks for 50 frames a second of 32x16, it offers YUYV 640x480 at up to "
       "30, MJPG 1280x720 at up to 30");
  driver_.modes = {{V4L2_PIX_FMT_YUYV, kWidth, kHeight, 10}};
  says(ErrorKind::kBadInput,
       "is too slow: board.toml asks for 50 frames a second of 32x16, it offers YUYV 32x16 at up to 10");
  driver_.modes = {{V4L2_PIX_FMT_H264, kWidth, kHeight, 50}};
  says(ErrorKind::kBadInput, "offers none of the formats");
  driver_.capabilities = V4L2_CAP_META_CAPTURE | V4L2_CAP_STREAMING;
  says(ErrorKind::kBadInput, "is not a capture device", "/dev/video0");
  driver_.capabilities = V4L2_CAP_VIDEO_CAPTURE_MPLANE | V4L2_CAP_STREAMING;
  says(ErrorKind::kBadInput, "use --camera libcamera:", "/dev/video0");
}

TEST_F(V4l2Camera, IsFoundByNameSerialAndIdentity) {
  driver_.nodes.push_back(
      {.path = "/dev/video2", .name = "Other Cam", .serial = "S-2", .vendor = 0x46d, .product = 0x825});
  for (const char* name : {"Test", "S-1", "1d6b:0102", "/dev/video0"}) EXPECT_TRUE(open(name)) << name;
  const std::string said = refusal(ErrorKind::kBadInput, "Cam");
  EXPECT_EQ(said,
            "several cameras: choose one with --camera v4l2:PATH of /dev/video0 (Test Cam, serial number S-1), "
            "/dev/video2 (Other Cam, serial number S-2)");
}

}  // namespace
}  // namespace ruffini
