#include "capture/alternating_camera.h"

#include <gtest/gtest.h>

#include <deque>
#include <vector>

#include "base/ambient.h"

namespace ruffini {
namespace {

constexpr size_t kBytes = size_t{4} * 2 * 3;
constexpr uint8_t kDay = 60;
constexpr uint8_t kLamps = 100;

// Numbered frames with daylight; odd ones with the lamps, too. -1: nothing came.
class DayCamera final : public Camera {
 public:
  explicit DayCamera(std::deque<int64_t> numbers) : numbers_(std::move(numbers)) {}
  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (numbers_.empty()) return CaptureStatus::kEnd;
    const int64_t number = numbers_.front();
    numbers_.pop_front();
    if (number < 0) return CaptureStatus::kNothing;
    buffer.number = static_cast<uint64_t>(number);
    buffer.capture_us = 1'000 * buffer.number;
    EXPECT_EQ(buffer.pixels.size(), kBytes);
    for (size_t i = 0; i < kBytes; ++i) {
      buffer.pixels[i] = static_cast<uint8_t>(kDay + i + (number % 2 == 1 ? kLamps : 0));
    }
    return CaptureStatus::kFrame;
  }
  [[nodiscard]] std::string problem() const override { return "the end"; }
  [[nodiscard]] bool is_simulated() const override { return true; }
  [[nodiscard]] bool is_replay() const override { return false; }

 private:
  std::deque<int64_t> numbers_;
};

struct Said {
  std::vector<uint64_t> pairs;
  int n_invalid = 0;
  std::string problem;
};

Said run(std::deque<int64_t> numbers, LampsDuring lamps = lamps_by_number) {
  const auto camera = alternate(std::make_unique<DayCamera>(std::move(numbers)), std::move(lamps), kBytes);
  EXPECT_TRUE(camera->is_simulated());
  FramePool pool(1, 4, 2);
  Said said;
  for (CaptureStatus status = camera->capture(pool[0]); status != CaptureStatus::kEnd;
       status = camera->capture(pool[0])) {
    said.n_invalid += status == CaptureStatus::kInvalidFrame ? 1 : 0;
    if (status != CaptureStatus::kFrame) continue;
    said.pairs.push_back(pool[0].number);
    EXPECT_EQ(pool[0].capture_us, 1'000 * (2 * pool[0].number + 1)) << "the lit one's";
    EXPECT_EQ(pool[0].pixels, std::vector<uint8_t>(kBytes, kLamps));
  }
  said.problem = camera->problem();
  return said;
}

TEST(TakeAmbientAway, LeavesWhatTheLampsMakeAndNeverLessThanNothing) {
  std::vector<uint8_t> lit = {0, 0, 254, 254, 255, 255, 7, 8, 9};
  const std::vector<uint8_t> dark = {0, 255, 0, 253, 0, 255, 8, 8, 8};
  take_ambient_away(lit, dark);
  EXPECT_EQ(lit, (std::vector<uint8_t>{0, 0, 254, 1, 255, 255, 0, 0, 1}));
}

TEST(AlternatingCamera, APairIsAFrameOfItsOwnNumberAndHalfTheRate) {
  const Said said = run({0, 1, 2, 3, -1, 4, -1, 5});
  EXPECT_EQ(said.pairs, (std::vector<uint64_t>{0, 1, 2}));
  EXPECT_EQ(said.n_invalid, 0);
  EXPECT_EQ(said.problem, "the end");
}

TEST(AlternatingCamera, ALitFrameWithoutItsDarkOneIsNotUsed) {
  const Said said = run({0, 1, 3, 4, 5});
  EXPECT_EQ(said.pairs, (std::vector<uint64_t>{0, 2}));
  EXPECT_EQ(said.n_invalid, 1);
}

TEST(AlternatingCamera, ADarkFrameWithoutItsLitOneIsNotUsedForALaterOne) {
  const Said said = run({0, 2, 3, 4, 7, 8, 9});
  EXPECT_EQ(said.pairs, (std::vector<uint64_t>{1, 4}));
  EXPECT_EQ(said.n_invalid, 2);  // 0, and 7 that follows a lost one
}

TEST(AlternatingCamera, AFrameOfWhichTheLampsAreNotKnownIsNotUsed) {
  const Said said = run({0, 1, 2, 3, 4, 5}, [](const FramePool::Buffer& frame) {
    return frame.number == 3 ? Lamps::kNotKnown : lamps_by_number(frame);
  });
  EXPECT_EQ(said.pairs, (std::vector<uint64_t>{0, 2}));
  EXPECT_EQ(said.n_invalid, 1);
}

TEST(AlternatingCamera, LampsThatNeverAlternateEndItWithASentence) {
  std::deque<int64_t> numbers;
  for (int64_t i = 0; i < 1'000; ++i) numbers.push_back(i);
  const Said said = run(std::move(numbers), [](const FramePool::Buffer&) { return Lamps::kLit; });
  EXPECT_TRUE(said.pairs.empty());
  EXPECT_EQ(said.n_invalid, 599);
  EXPECT_NE(said.problem.find("light.alternation: no lit frame follows a dark one"), std::string::npos);
}

}  // namespace
}  // namespace ruffini
