#include "capture/paired_camera.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <string>

namespace ruffini {
namespace {

constexpr int kWidth = 4;
constexpr int kHeight = 3;
constexpr uint64_t kPeriodUs = 16'667;
constexpr uint64_t kToleranceUs = 500;

struct Taken {
  uint64_t number = 0;
  uint64_t capture_us = 0;
  CaptureStatus status = CaptureStatus::kFrame;
};

// Gives the frames of a list; every byte of a frame is its number's lowest, plus `mark`.
class ListCamera final : public Camera {
 public:
  ListCamera(std::deque<Taken> frames, uint8_t mark, std::string end = {}, bool is_replay = false)
      : frames_(std::move(frames)), mark_(mark), end_(std::move(end)), is_replay_(is_replay) {}
  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (frames_.empty()) return CaptureStatus::kEnd;
    const Taken next = frames_.front();
    frames_.pop_front();
    if (next.status != CaptureStatus::kFrame) return next.status;
    EXPECT_EQ(buffer.pixels.size(), size_t{kWidth / 2 * kHeight * 3});
    buffer.number = next.number;
    buffer.capture_us = next.capture_us;
    std::fill(buffer.pixels.begin(), buffer.pixels.end(), static_cast<uint8_t>(next.number + mark_));
    return CaptureStatus::kFrame;
  }
  [[nodiscard]] std::string problem() const override { return frames_.empty() ? end_ : ""; }
  [[nodiscard]] bool is_simulated() const override { return false; }
  [[nodiscard]] bool is_replay() const override { return is_replay_; }

 private:
  std::deque<Taken> frames_;
  uint8_t mark_;
  std::string end_;
  bool is_replay_;
};

struct Said {
  int n_invalid = 0;
  int n_nothing = 0;
  std::vector<Taken> pairs;
  std::string problem;
};

class PairedCameraTest : public testing::Test {
 protected:
  Said run(std::deque<Taken> left, std::deque<Taken> right, const std::string& end = "") {
    auto both = pair_cameras(std::make_unique<ListCamera>(std::move(left), 0),
                             std::make_unique<ListCamera>(std::move(right), 100, end), kWidth, kHeight, kToleranceUs);
    EXPECT_TRUE(both);
    FramePool pool(1, kWidth, kHeight);
    FramePool::Buffer& buffer = pool[0];
    Said said;
    for (int i = 0; i < 5'000; ++i) {
      const CaptureStatus status = both.value()->capture(buffer);
      if (status == CaptureStatus::kEnd) break;
      if (status == CaptureStatus::kInvalidFrame) ++said.n_invalid;
      if (status == CaptureStatus::kNothing) ++said.n_nothing;
      if (status != CaptureStatus::kFrame) continue;
      said.pairs.push_back({buffer.number, buffer.capture_us});
      check(buffer);
    }
    said.problem = both.value()->problem();
    return said;
  }
  // Left the left one's bytes, right those of the frame of the same number.
  static void check(const FramePool::Buffer& buffer) {
    for (size_t i = 0; i < buffer.pixels.size(); ++i) {
      const bool is_left = i / 3 % kWidth < kWidth / 2;
      ASSERT_EQ(buffer.pixels[i], static_cast<uint8_t>(buffer.number + (is_left ? 0 : 100))) << i;
    }
  }
  // Frames from `first` to before `end`, their times off by up to `jitter_us` to both sides.
  static std::deque<Taken> frames(uint64_t first, uint64_t end, uint64_t jitter_us, uint32_t seed) {
    std::deque<Taken> all;
    for (uint64_t i = first; i < end; ++i) {
      seed = seed * 1'664'525 + 1'013'904'223;
      const uint64_t off_us = jitter_us == 0 ? 0 : (seed >> 8) % (2 * jitter_us + 1);
      all.push_back({i, 1'000'000 + i * kPeriodUs + off_us});
    }
    return all;
  }
};

TEST_F(PairedCameraTest, FramesWithJitterFindTheirPartners) {
  const Said said = run(frames(0, 200, 250, 1), frames(0, 200, 250, 2));
  EXPECT_EQ(said.pairs.size(), 200U);
  EXPECT_EQ(said.n_invalid, 0);
  EXPECT_EQ(said.problem, "");
}

TEST_F(PairedCameraTest, ThePairsTimeIsInTheMiddle) {
  const Said said = run({{7, 1'000'000}}, {{7, 1'000'401}});
  ASSERT_EQ(said.pairs.size(), 1U);
  EXPECT_EQ(said.pairs[0].number, 7U);
  EXPECT_EQ(said.pairs[0].capture_us, 1'000'200U);
}

TEST_F(PairedCameraTest, TheToleranceIsTheLimit) {
  EXPECT_EQ(run({{0, 1'000'000}}, {{0, 1'000'500}}).pairs.size(), 1U);
  const Said beyond = run({{0, 1'000'000}}, {{0, 1'000'501}});
  EXPECT_TRUE(beyond.pairs.empty());
  EXPECT_EQ(beyond.n_invalid, 1);
}

TEST_F(PairedCameraTest, LostPartnersAreCountedAndTheNextPairsAreRight) {
  std::deque<Taken> left = frames(0, 300, 200, 3);
  std::deque<Taken> right = frames(0, 300, 200, 4);
  // Left loses 5 frames, right 3 others, one of them beside a left one.
  for (const int i : {250, 121, 120, 60, 10}) left.erase(left.begin() + i);
  for (const int i : {200, 119, 30}) right.erase(right.begin() + i);
  const Said said = run(std::move(left), std::move(right));
  EXPECT_EQ(said.pairs.size(), 300U - 8U);
  EXPECT_EQ(said.n_invalid, 8);
}

TEST_F(PairedCameraTest, AStallOfOneIsBorne) {
  std::deque<Taken> left = frames(0, 40, 0, 1);
  for (size_t i = 20; i < 30; ++i) left[i].status = CaptureStatus::kNothing;
  const Said said = run(std::move(left), frames(0, 40, 0, 1));
  EXPECT_EQ(said.n_nothing, 10);
  EXPECT_EQ(said.n_invalid, 10);  // of the right one, while the left one stood
  EXPECT_EQ(said.pairs.size(), 30U);
}

TEST_F(PairedCameraTest, AnInvalidFrameOfOneIsOneOfThePair) {
  std::deque<Taken> right = frames(0, 5, 0, 1);
  right[2].status = CaptureStatus::kInvalidFrame;
  const Said said = run(frames(0, 5, 0, 1), std::move(right));
  EXPECT_EQ(said.n_invalid, 2);  // that one, and the left one beside it
  EXPECT_EQ(said.pairs.size(), 4U);
}

TEST_F(PairedCameraTest, OneThatIsUnpluggedEndsThePairWithItsSentence) {
  const Said said = run(frames(0, 20, 0, 1), frames(0, 10, 0, 1), "camera B was unplugged");
  EXPECT_EQ(said.pairs.size(), 10U);
  EXPECT_EQ(said.problem, "camera B was unplugged");
}

TEST_F(PairedCameraTest, CamerasThatNeverMeetEndWithWhatToDo) {
  std::deque<Taken> right = frames(0, 400, 0, 1);
  for (Taken& one : right) one.capture_us += kPeriodUs / 2;
  const Said said = run(frames(0, 400, 0, 1), std::move(right));
  EXPECT_TRUE(said.pairs.empty());
  EXPECT_EQ(said.n_invalid, 299);
  EXPECT_NE(said.problem.find("were 8334 us apart, stereo.tolerance_us is 500"), std::string::npos) << said.problem;
}

TEST_F(PairedCameraTest, RecordingsArePairedByNumber) {
  auto both = pair_cameras(
      std::make_unique<ListCamera>(std::deque<Taken>{{0, 10}, {1, 900'000}, {2, 900'001}}, 0, "", true),
      std::make_unique<ListCamera>(std::deque<Taken>{{0, 800'000}, {2, 900'000}}, 100, "", true), kWidth, kHeight, 1);
  ASSERT_TRUE(both);
  EXPECT_TRUE(both.value()->is_replay());
  FramePool pool(1, kWidth, kHeight);
  std::vector<CaptureStatus> said;
  for (int i = 0; i < 4; ++i) said.push_back(both.value()->capture(pool[0]));
  EXPECT_EQ(said, (std::vector{CaptureStatus::kFrame, CaptureStatus::kInvalidFrame, CaptureStatus::kFrame,
                               CaptureStatus::kEnd}));
  EXPECT_EQ(both.value()->problem(), "");
}

TEST_F(PairedCameraTest, ALiveOneAndARecordingAreNoPair) {
  const auto both = pair_cameras(std::make_unique<ListCamera>(std::deque<Taken>{}, 0, "", true),
                                 std::make_unique<ListCamera>(std::deque<Taken>{}, 0), kWidth, kHeight, kToleranceUs);
  ASSERT_FALSE(both);
  EXPECT_EQ(both.error().kind, ErrorKind::kBadInput);
}

}  // namespace
}  // namespace ruffini
