#include "capture/replay_camera.h"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>
#include <span>

#include "support/test_board.h"

namespace ruffini {
namespace {

namespace fs = std::filesystem;

// As PNG has it.
uint32_t crc32_of(std::span<const uint8_t> bytes) {
  uint32_t crc = 0xFFFF'FFFF;
  for (const uint8_t byte : bytes) {
    crc ^= byte;
    for (int i = 0; i < 8; ++i) crc = (crc >> 1) ^ ((crc & 1) != 0 ? 0xEDB8'8320 : 0);
  }
  return ~crc;
}

class ReplayCameraTest : public testing::Test {
 protected:
  ReplayCameraTest()
      : folder_(fs::path(testing::TempDir()) / ("replay_camera_test" + std::to_string(::getpid()))),
        pool_(1, board_.camera.width_px, board_.camera.height_px) {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
  }
  ~ReplayCameraTest() override { fs::remove_all(folder_); }

  void picture(const std::string& name, int level, cv::Size size = {160, 120}) const {
    ASSERT_TRUE(
        cv::imwrite((folder_ / name).string(), cv::Mat(size, CV_8UC3, cv::Scalar(level, level + 1, level + 2))));
  }
  void write(const std::string& name, const std::string& text) const { std::ofstream(folder_ / name) << text; }

  [[nodiscard]] Result<std::unique_ptr<Camera>> open(const std::string& path, bool is_loop = false) const {
    return open_replay({.path = path, .is_lockstep = true, .is_loop = is_loop}, board_, clock_);
  }
  struct StoppedClock final : Clock {
    uint64_t us = 1'000'000;
    [[nodiscard]] uint64_t now_us() const override { return us; }
  };
  [[nodiscard]] std::unique_ptr<Camera> camera(bool is_loop = false) const {
    return open(folder_.string(), is_loop).value();
  }
  // Why a recording is not opened.
  [[nodiscard]] Error refusal(const std::string& path) const {
    const auto opened = open(path);
    EXPECT_FALSE(opened) << path << " was opened";
    return opened ? Error{} : opened.error();
  }
  void expect_refused(ErrorKind kind, const std::string& words) const {
    const Error error = refusal(folder_.string());
    EXPECT_EQ(error.kind, kind) << error.message;
    EXPECT_NE(error.message.find(words), std::string::npos) << error.message;
  }
  // Level of the next frame's first pixel; -1 at the end, -2 for an invalid frame.
  int next(Camera& camera) {
    switch (camera.capture(pool_[0])) {
      case CaptureStatus::kFrame:
        return pool_[0].pixels[0];
      case CaptureStatus::kInvalidFrame:
        return -2;
      default:
        return -1;
    }
  }

  BoardSettings board_ = test::round_board();
  StoppedClock clock_;
  fs::path folder_;
  FramePool pool_;
};

// A header that claims 100,000 x 100,000 pixels: OpenCV throws; a pipe would be waited for without end.
TEST_F(ReplayCameraTest, WhatIsTooLargeOrAPipeIsAnInvalidFrame) {
  picture("a.png", 10);
  std::vector<uint8_t> png;
  ASSERT_TRUE(cv::imencode(".png", cv::Mat(cv::Size(160, 120), CV_8UC3, cv::Scalar(1, 2, 3)), png));
  constexpr size_t kWidthAt = 16, kCrcAt = 29;
  for (const size_t at : {kWidthAt, kWidthAt + 4}) png[at + 1] = 1, png[at + 2] = 0x86, png[at + 3] = 0xA0;
  const uint32_t crc = crc32_of({png.data() + 12, 17});
  for (size_t i = 0; i < 4; ++i) png[kCrcAt + i] = static_cast<uint8_t>(crc >> (24 - 8 * i));
  std::ofstream(folder_ / "b.png", std::ios::binary)
      .write(reinterpret_cast<const char*>(png.data()), static_cast<std::streamsize>(png.size()));
  ASSERT_EQ(::mkfifo((folder_ / "c.png").c_str(), 0600), 0);
  picture("d.png", 40);
  const auto replay = camera();
  EXPECT_EQ(next(*replay), 10);
  EXPECT_EQ(next(*replay), -2);
  EXPECT_EQ(next(*replay), -2);
  EXPECT_EQ(next(*replay), 40);
  EXPECT_EQ(next(*replay), -1);
  EXPECT_NE(refusal((folder_ / "c.png").string()).message.find("cannot be read as a video"), std::string::npos);
}

TEST_F(ReplayCameraTest, AFolderPlaysInTheOrderOfItsNames) {
  picture("b.png", 20);
  picture("c.bmp", 30);
  picture("a.png", 10);
  write("notes.txt", "no picture");
  const auto replay = camera();
  EXPECT_EQ(next(*replay), 10);
  for (size_t i = 0; i < pool_[0].pixels.size(); ++i) ASSERT_EQ(pool_[0].pixels[i], 10 + i % 3) << i;  // B, G, R
  EXPECT_EQ(pool_[0].number, 0U);
  EXPECT_EQ(next(*replay), 20);
  const uint64_t before_us = pool_[0].capture_us;
  EXPECT_EQ(next(*replay), 30);
  EXPECT_EQ(pool_[0].number, 2U);
  EXPECT_GE(pool_[0].capture_us, before_us);
  EXPECT_EQ(next(*replay), -1);
  EXPECT_EQ(next(*replay), -1);
  EXPECT_TRUE(replay->is_replay());
  EXPECT_FALSE(replay->is_simulated());
}

TEST_F(ReplayCameraTest, FramesHaveAFolderOfTheirOwnInARecording) {
  fs::create_directory(folder_ / "frames");
  picture("preview.png", 99);
  picture("frames/0.png", 10);
  EXPECT_EQ(next(*camera()), 10);
}

TEST_F(ReplayCameraTest, ALoopStartsAgainAndGoesOnCounting) {
  picture("a.png", 10);
  picture("b.png", 20);
  const auto replay = camera(true);
  for (const int level : {10, 20, 10, 20, 10}) EXPECT_EQ(next(*replay), level);
  EXPECT_EQ(pool_[0].number, 4U);
}

TEST_F(ReplayCameraTest, OneImageIsOneFrame) {
  picture("a.bmp", 10);
  const std::string path = (folder_ / "a.bmp").string();
  const auto replay = open(path).value(), loop = open(path, true).value();
  for (const int level : {10, -1, -1}) EXPECT_EQ(next(*replay), level);
  for (const int level : {10, 10, 10}) EXPECT_EQ(next(*loop), level);
}

TEST_F(ReplayCameraTest, ASpoiltFrameIsInvalidAndTheNextOneGood) {
  picture("a.png", 10);
  write("b.png", "no picture");
  picture("c.png", 30, {80, 60});
  picture("d.png", 40);
  const auto replay = camera();
  for (const int level : {10, -2, -2, 40, -1}) EXPECT_EQ(next(*replay), level);
  EXPECT_EQ(pool_[0].number, 3U);
}

TEST_F(ReplayCameraTest, AGreyPictureBecomesThreeEqualColours) {
  cv::imwrite((folder_ / "a.png").string(), cv::Mat(120, 160, CV_8UC1, cv::Scalar(77)));
  const auto replay = camera();
  EXPECT_EQ(next(*replay), 77);
  EXPECT_EQ(pool_[0].pixels[2], 77);
}

TEST_F(ReplayCameraTest, AVideoPlaysAtItsOwnSizeOnly) {
  const auto video = [this](const char* name, cv::Size size) {
    const std::string path = (folder_ / name).string();
    cv::VideoWriter out(path, cv::VideoWriter::fourcc('M', 'J', 'P', 'G'), 50, size);
    for (const int level : {40, 80, 120}) out.write(cv::Mat(size, CV_8UC3, cv::Scalar::all(level)));
    return path;
  };
  const auto replay = open(video("good.avi", {160, 120}), true).value();
  for (const int level : {40, 80, 120, 40}) EXPECT_NEAR(next(*replay), level, 3);  // JPEG
  const Error error = refusal(video("small.avi", {80, 60}));
  EXPECT_EQ(error.kind, ErrorKind::kBadInput);
  EXPECT_NE(error.message.find("80x60"), std::string::npos) << error.message;
}

TEST_F(ReplayCameraTest, WhatIsNoVideoIsNamed) {
  write("video.mp4", "no video");
  for (const char* name : {"video.mp4", "nothing.mp4"}) {
    const Error error = refusal((folder_ / name).string());
    EXPECT_EQ(error.kind, ErrorKind::kUnavailable);
    EXPECT_NE(error.message.find(name), std::string::npos) << error.message;
  }
}

TEST_F(ReplayCameraTest, AFolderWithoutAFirstFrameIsRefused) {
  expect_refused(ErrorKind::kUnavailable, "holds no PNG");
  write("a.png", "no picture");
  expect_refused(ErrorKind::kUnavailable, "cannot be read");
  picture("a.png", 10, {160, 121});
  expect_refused(ErrorKind::kBadInput, "160x121");
}

TEST_F(ReplayCameraTest, TheRecordingSaysWhatItIs) {
  picture("a.png", 10);
  write("recording.toml", "simulated = true\nboard = \"round\"\nrate_mhz = 100000\nseed = 5\n[twin]\nx = 1.5\n");
  EXPECT_TRUE(camera()->is_simulated());
  write("recording.toml", "simulated = false\n");
  EXPECT_FALSE(camera()->is_simulated());
}

TEST_F(ReplayCameraTest, ARecordingThatCannotBeUnderstoodIsRefused) {
  picture("a.png", 10);
  for (const auto& [text, words] : std::vector<std::pair<std::string, std::string>>{
           {"board = \"square\"", "\"square\""},
           {"board = 5", "board must"},
           {"simulated = \"yes\"", "simulated must"},
           {"simulated = 1", "simulated must"},
           {"rate_mhz = 60.0", "rate_mhz must"},
           {"rate_mhz = 0", "rate_mhz must"},
           {"rate_mhz = 1000001", "rate_mhz must"},
           {"rate_mhz = ", "not TOML"},
           {"# gr\xC3\xBCn", "plain ASCII"},
       }) {
    write("recording.toml", text);
    expect_refused(ErrorKind::kBadInput, words);
  }
}

TEST_F(ReplayCameraTest, ARecordingTomlThatCannotBeOpenedIsNamed) {
  picture("a.png", 10);
  fs::create_symlink("recording.toml", folder_ / "recording.toml");  // leads to itself
  expect_refused(ErrorKind::kUnavailable, "recording.toml: is not a file that can be read");
}

TEST_F(ReplayCameraTest, FramesComeAtTheRecordingsPaceUnlessInLockstep) {
  for (const char* name : {"a.png", "b.png", "c.png", "d.png"}) picture(name, 10);
  write("recording.toml", "rate_mhz = 100");  // one frame in ten seconds
  const ReplayOptions paced{.path = folder_.string(), .is_lockstep = false, .is_loop = false};
  const auto replay = open_replay(paced, board_, clock_).value();
  const uint64_t start_us = clock_.us;
  ASSERT_EQ(replay->capture(pool_[0]), CaptureStatus::kFrame);
  EXPECT_EQ(replay->capture(pool_[0]), CaptureStatus::kNothing);
  clock_.us += 9'999'999;
  EXPECT_EQ(replay->capture(pool_[0]), CaptureStatus::kNothing);
  clock_.us += 1;
  ASSERT_EQ(replay->capture(pool_[0]), CaptureStatus::kFrame);
  EXPECT_EQ(pool_[0].capture_us, start_us + 10'000'000);
  clock_.us += 25'000'000;  // a reader that fell behind gets no burst
  EXPECT_EQ(replay->capture(pool_[0]), CaptureStatus::kFrame);
  EXPECT_EQ(replay->capture(pool_[0]), CaptureStatus::kNothing);
  clock_.us += 10'000'000;
  EXPECT_EQ(replay->capture(pool_[0]), CaptureStatus::kFrame);
  EXPECT_EQ(replay->capture(pool_[0]), CaptureStatus::kEnd);

  const auto lockstep = camera();
  for (int i = 0; i < 4; ++i) EXPECT_EQ(lockstep->capture(pool_[0]), CaptureStatus::kFrame);
}

}  // namespace
}  // namespace ruffini
