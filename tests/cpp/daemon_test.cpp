// The daemon's steps on a clock that this test sets: what STATUS says of time.
#include "daemon.h"

#include <gtest/gtest.h>
#include <pb_decode.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "support/fake_seams.h"
#include "support/scenes.h"
#include "support/session_fixture.h"

namespace ruffini {
namespace {

using test::Bytes;
using test::host_frame;

constexpr uint64_t kPeriodUs = 16'667;
constexpr uint64_t kExposureUs = 4'000;

test::FakeClock now;
uint64_t work_us = 0;  // of the frame that is processed next

struct Coded : test::SessionTest {
  using SessionTest::encoded;
};

// The frame path's clock.
uint64_t working_clock() {
  now.us += std::exchange(work_us, 0);
  return 0;
}

// A frame that ended its exposure just now.
class PromptCamera : public Camera {
 public:
  explicit PromptCamera(const std::vector<uint8_t>& picture) : picture_(picture) {}
  CaptureStatus capture(FramePool::Buffer& buffer) override {
    buffer.pixels = picture_;
    buffer.pixels[0] = static_cast<uint8_t>(number_);  // repeats no picture
    buffer.number = number_++;
    buffer.capture_us = now.us - kExposureUs / 2;
    return CaptureStatus::kFrame;
  }
  [[nodiscard]] bool is_simulated() const override { return true; }
  [[nodiscard]] bool is_replay() const override { return false; }

 private:
  const std::vector<uint8_t>& picture_;
  uint64_t number_ = 0;
};

// Accepts `room` bytes, each piece after `delay_us`.
struct Line {
  Bytes to_device;
  Bytes to_host;
  size_t room = SIZE_MAX;
  uint64_t delay_us = 0;
  int n_wakes = 0;
  std::function<void()> when_woken = [] {};
};
class LineDouble : public Link {
 public:
  explicit LineDouble(Line& line) : line_(line) {}
  int read(std::span<uint8_t> out) override {
    const size_t n = std::min(out.size(), line_.to_device.size());
    std::copy_n(line_.to_device.begin(), n, out.begin());
    line_.to_device.erase(line_.to_device.begin(), line_.to_device.begin() + static_cast<ptrdiff_t>(n));
    return static_cast<int>(n);
  }
  int write(std::span<const uint8_t> bytes) override {
    const size_t n = std::min(bytes.size(), line_.room);
    line_.room -= n;
    now.us += n == 0 ? 0 : line_.delay_us;
    line_.to_host.insert(line_.to_host.end(), bytes.begin(), bytes.begin() + static_cast<ptrdiff_t>(n));
    return static_cast<int>(n);
  }
  void wait(bool /*is_writing*/, int /*timeout_ms*/) override {}
  void wake() override {
    ++line_.n_wakes;
    line_.when_woken();
  }
  [[nodiscard]] bool has_unsent() const override { return false; }
  bool reopen() override { return true; }

 private:
  Line& line_;
};

class IoDouble : public BoardIo {
 public:
  explicit IoDouble(const uint32_t& throttled) : throttled_(throttled) {}
  [[nodiscard]] std::optional<int32_t> milli_celsius() const override { return std::nullopt; }
  [[nodiscard]] std::optional<uint32_t> throttled() const override { return throttled_; }

 private:
  const uint32_t& throttled_;
};

class DaemonTest : public testing::Test {
 protected:
  explicit DaemonTest(int n_cores = 1, DaemonOptions options = {})
      : scene_(test::dots()), folder_(testing::TempDir() + "daemon_test" + std::to_string(::getpid())) {
    now.us = 1'000'000;
    work_us = 0;
    scene_.board.camera.rate_mhz = 60'000;
    scene_.board.n_cores = n_cores;
    scene_.board.exposure.time_us = kExposureUs;
    calibrator_ = std::make_unique<Calibrator>(scene_.board, "0042", SlotStore::open(folder_).value(), exchange_);
    auto path = FramePath::configure(scene_.board, CalibrationFile::load(scene_.calibration).value(), working_clock);
    daemon_ = std::make_unique<Daemon>(scene_.board, std::move(path).value(),
                                       DaemonDevices{.clock = now,
                                                     .random = random_,
                                                     .camera = std::make_unique<PromptCamera>(scene_.rest),
                                                     .link = std::make_unique<LineDouble>(line_),
                                                     .io = std::make_unique<IoDouble>(throttled_)},
                                       *calibrator_, exchange_, DeviceIdentity{.serial = "0042", .version = "test"},
                                       std::move(options));
    ruffini_Command wrench = ruffini_Command_init_zero;
    wrench.request_id = 1;
    wrench.which_action = ruffini_Command_subscribe_tag;
    wrench.action.subscribe.subscriptions_count = 1;
    wrench.action.subscribe.subscriptions[0] = {ruffini_MessageType_MESSAGE_TYPE_WRENCH, 1};
    line_.to_device = host_frame(ruffini_MessageType_MESSAGE_TYPE_COMMAND, Coded::encoded(wrench));
    serve();
  }
  ~DaemonTest() override { std::filesystem::remove_all(folder_); }

  void serve() {
    EXPECT_TRUE(daemon_->serve_once(0));
    EXPECT_TRUE(daemon_->serve_once(0));
  }
  // One period of the camera: its frame takes `busy_us` to process.
  void frame(uint64_t busy_us) {
    const uint64_t start_us = now.us;
    EXPECT_TRUE(daemon_->capture_once());
    work_us = busy_us;
    daemon_->process_once();
    work_us = 0;
    serve();
    now.us = std::max(now.us, start_us + kPeriodUs);
  }
  void learn_rest() {
    for (int i = 0; i < scene_.board.n_rest_frames; ++i) frame(0);
  }
  ruffini_Status status() {
    line_.to_host.clear();
    line_.to_device = host_frame(ruffini_MessageType_MESSAGE_TYPE_STATUS);
    serve();
    ruffini_Status out = ruffini_Status_init_zero;
    bool is_there = false;
    FrameDecoder decoder;
    for (const uint8_t byte : line_.to_host) {
      const auto frame = decoder.push(byte);
      if (!frame || frame->header.type != ruffini_MessageType_MESSAGE_TYPE_STATUS) continue;
      pb_istream_t in = pb_istream_from_buffer(frame->payload.data(), frame->payload.size());
      is_there = pb_decode(&in, ruffini_Status_fields, &out);
    }
    EXPECT_TRUE(is_there);
    return out;
  }

  // Frames processed in so many seconds; with `busy_us` each.
  uint64_t seconds(int n, uint64_t busy_us) {
    const uint64_t before = exchange_.frames_processed;
    for (int i = 0; i < 60 * n; ++i) frame(busy_us);
    return exchange_.frames_processed - before;
  }
  // Whether the device has sent this event since the last call.
  bool was_told(const std::string& what) {
    const Bytes sent = std::exchange(line_.to_host, {});
    FrameDecoder decoder;
    bool is_there = false;
    for (const uint8_t byte : sent) {
      const auto frame = decoder.push(byte);
      if (!frame || frame->header.type != ruffini_MessageType_MESSAGE_TYPE_EVENT) continue;
      ruffini_Event event = ruffini_Event_init_zero;
      pb_istream_t in = pb_istream_from_buffer(frame->payload.data(), frame->payload.size());
      EXPECT_TRUE(pb_decode(&in, ruffini_Event_fields, &event));
      is_there = is_there || event.what == what;
    }
    return is_there;
  }

  test::Scene scene_;
  std::string folder_;
  Line line_;
  uint32_t throttled_ = 0;
  Exchange exchange_;
  test::FakeRandom random_;
  std::unique_ptr<Calibrator> calibrator_;
  std::unique_ptr<Daemon> daemon_;
};

TEST_F(DaemonTest, LatencyIsFromTheEndOfTheExposureToTheLastByte) {
  for (int i = 0; i < 98; ++i) frame(5'000);
  for (int i = 0; i < 2; ++i) frame(12'000);
  line_.delay_us = 1'000;
  frame(5'000);
  line_.delay_us = 0;
  const ruffini_Status said = status();
  EXPECT_EQ(said.line_latency.n_frames, 101U);
  EXPECT_NEAR(said.line_latency.p50_us, 5'000, 5'000 / 32);
  EXPECT_GE(said.line_latency.p50_us, 5'000U);
  EXPECT_NEAR(said.line_latency.p99_us, 12'000, 12'000 / 32);
  EXPECT_EQ(said.line_latency.max_us, 12'000U);
  EXPECT_FALSE(said.scheduling.is_memory_locked);
}

TEST_F(DaemonTest, AFrameThatTheLineHoldsBackIsAsLateAsItsLastByte) {
  line_.room = 10;  // a part of the message
  frame(5'000);
  EXPECT_EQ(line_.room, 0U);
  now.us += 300'000;
  line_.room = SIZE_MAX;
  serve();
  const ruffini_Status said = status();
  EXPECT_EQ(said.line_latency.n_frames, 1U);
  EXPECT_EQ(said.line_latency.max_us, kPeriodUs + 300'000);
}

// Each frame takes as long as with a host that reads, and the link thread is woken once for each.
TEST_F(DaemonTest, AHostThatDoesNotReadDelaysNoFrame) {
  line_.room = 0;
  const uint64_t before_us = now.us;
  line_.n_wakes = 0;
  for (int i = 0; i < 200; ++i) frame(5'000);
  EXPECT_EQ(exchange_.frames_processed, 200U);
  EXPECT_EQ(exchange_.frames_overrun, 0U);
  EXPECT_EQ(now.us - before_us, 200 * kPeriodUs);
  EXPECT_EQ(line_.n_wakes, 200);
  line_.room = SIZE_MAX;
  const ruffini_Status said = status();
  EXPECT_EQ(said.drops.link_replaced, 199U);
  EXPECT_LE(said.line_latency.max_us, kPeriodUs) << "the newest is sent, not the oldest";
}

class TwoCoresTest : public DaemonTest {
 protected:
  TwoCoresTest() : DaemonTest(2) {}
};

class SavedRestTest : public DaemonTest {
 protected:
  SavedRestTest()
      : DaemonTest(1, {.save_rest = [this](std::span<const uint16_t> rest) {
                     saved_.emplace_back(rest.begin(), rest.end());
                   }}) {}

  std::vector<std::vector<uint16_t>> saved_;
};

// Saved by the end of the frame that completes it: another may never come.
TEST_F(SavedRestTest, EachZeroIsSavedWithItsLastFrame) {
  learn_rest();
  EXPECT_TRUE(saved_.empty()) << "nothing says that the pad was untouched";
  std::vector<uint16_t> expected(scene_.rest.size());
  std::transform(scene_.rest.begin(), scene_.rest.end(), expected.begin(),
                 [](uint8_t v) { return static_cast<uint16_t>(16 * v); });
  for (size_t n_zeros = 1; n_zeros <= 2; ++n_zeros) {
    exchange_.zero_frames = 5;
    for (int i = 0; i < 5; ++i) {
      EXPECT_EQ(saved_.size(), n_zeros - 1);
      frame(0);
    }
    ASSERT_EQ(saved_.size(), n_zeros);
    expected[0] = saved_.back()[0];  // each picture has another first value
    EXPECT_EQ(saved_.back(), expected);
  }
}
TEST_F(SavedRestTest, AZeroThatIsGivenUpIsNotSavedAndTheNextOneIs) {
  learn_rest();
  exchange_.zero_frames = 5;
  frame(0);
  frame(0);
  exchange_.zero_frames = kCancelZero;
  for (int i = 0; i < 5; ++i) frame(0);
  EXPECT_TRUE(saved_.empty());
  exchange_.zero_frames = 3;
  for (int i = 0; i < 3; ++i) frame(0);
  EXPECT_EQ(saved_.size(), 1U);
}

// Two intervals and a half after capture: with two cores the next frame is on its way, and none waits.
TEST_F(DaemonTest, AFrameThatKeepsTheNextOneWaitingIsLate) {
  learn_rest();
  frame(5 * kPeriodUs / 2);
  EXPECT_EQ(status().missed_deadlines, 1U);
}
TEST_F(TwoCoresTest, AFrameBesideTheNextOneIsNotLateUntilAThirdWaits) {
  learn_rest();
  frame(5 * kPeriodUs / 2);
  EXPECT_EQ(status().missed_deadlines, 0U);
  frame(7 * kPeriodUs / 2);
  EXPECT_EQ(status().missed_deadlines, 1U);
}

// Otherwise the event that the camera is back would come after the first frame.
TEST_F(DaemonTest, TheLinkThreadIsWokenOnceTheFrameIsCounted) {
  std::vector<uint64_t> seen;
  line_.when_woken = [&] { seen.push_back(exchange_.frames_processed); };
  for (int i = 0; i < 3; ++i) frame(5'000);
  EXPECT_EQ(seen, (std::vector<uint64_t>{1, 2, 3}));
}

// A frame takes 14 ms at 60 Hz, then 20 ms, then 12 ms.
TEST_F(DaemonTest, HalfTheFramesComeWhereAllCannotBeHeld) {
  EXPECT_EQ(seconds(5, 14'000), 300U);
  EXPECT_EQ(status().rate_divisor, 1U);
  seconds(4, 20'000);
  EXPECT_TRUE(was_told("rate_halved"));
  EXPECT_EQ(seconds(5, 20'000), 150U);
  ruffini_Status said = status();
  EXPECT_EQ(said.rate_divisor, 2U);
  EXPECT_TRUE(said.health & ruffini_HealthBit_HEALTH_RATE);
  EXPECT_EQ(said.drops.capture_overrun, 0U);
  EXPECT_EQ(said.frames_captured, said.frames_processed + said.frames_left_out);
  EXPECT_FALSE(said.health & ruffini_HealthBit_HEALTH_LATE);
  EXPECT_EQ(seconds(9, 12'000), 270U);
  EXPECT_FALSE(was_told("rate_restored"));
  seconds(2, 12'000);
  EXPECT_TRUE(was_told("rate_restored"));
  EXPECT_EQ(seconds(5, 12'000), 300U);
  EXPECT_EQ(status().health & ruffini_HealthBit_HEALTH_RATE, 0U);
}

TEST_F(DaemonTest, AComputerThatLowersItsClockGetsHalfTheFrames) {
  throttled_ = 0x9;  // short of power and near the limit, at full clock
  EXPECT_EQ(seconds(5, 5'000), 300U);
  throttled_ = 0x4;
  seconds(5, 5'000);
  EXPECT_TRUE(was_told("rate_halved"));
  EXPECT_EQ(seconds(20, 5'000), 600U);
  throttled_ = 0x40000;  // it was
  seconds(13, 5'000);
  EXPECT_TRUE(was_told("rate_restored"));
  EXPECT_EQ(seconds(2, 5'000), 120U);
}

}  // namespace
}  // namespace ruffini
