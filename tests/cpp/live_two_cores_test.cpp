// A live camera with [pipeline] cores = 2: what is dropped, whose result is whose, and when the rate is halved.
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "daemon.h"
#include "support/fake_seams.h"
#include "support/scenes.h"
#include "support/wait_until.h"

namespace ruffini {
namespace {

using namespace std::chrono_literals;
using Bytes = std::vector<uint8_t>;

// Of the two frame threads, and of others. Threads name themselves when they start: the first one first.
constexpr int kOther = -1, kFirst = 0, kSecond = 1;
thread_local int my_place = kOther;
std::atomic<int> n_frame_threads{0};

// Frames of the camera that need no more work.
uint64_t ended(const Exchange& e) {
  return e.frames_processed + e.frames_overrun + e.frames_invalid + e.frames_repeated + e.frames_left_out;
}

// A host that takes everything. `when_woken`: called by the second frame thread at each frame's end.
class OpenLine : public Link {
 public:
  OpenLine(Bytes& to_host, std::function<void()> when_woken, std::function<void()> when_idle)
      : to_host_(to_host), when_woken_(std::move(when_woken)), when_idle_(std::move(when_idle)) {}
  int read(std::span<uint8_t> /*out*/) override { return 0; }
  int write(std::span<const uint8_t> bytes) override {
    to_host_.insert(to_host_.end(), bytes.begin(), bytes.end());
    return static_cast<int>(bytes.size());
  }
  void wait(bool is_writing, int /*timeout_ms*/) override {
    if (is_writing) return;
    when_idle_();
    std::this_thread::sleep_for(50us);
  }
  void wake() override { when_woken_(); }
  [[nodiscard]] bool has_unsent() const override { return false; }
  bool reopen() override { return true; }

 private:
  Bytes& to_host_;
  std::function<void()> when_woken_;
  std::function<void()> when_idle_;
};

class QuietIo : public BoardIo {
 public:
  [[nodiscard]] std::optional<int32_t> milli_celsius() const override { return std::nullopt; }
};

// Calls `next` for each frame.
class LiveCamera : public Camera {
 public:
  explicit LiveCamera(std::function<CaptureStatus(FramePool::Buffer&)> next) : next_(std::move(next)) {}
  CaptureStatus capture(FramePool::Buffer& buffer) override { return next_(buffer); }
  [[nodiscard]] bool is_simulated() const override { return true; }
  [[nodiscard]] bool is_replay() const override { return false; }

 private:
  std::function<CaptureStatus(FramePool::Buffer&)> next_;
};

test::Scene two_core_dots() {
  test::Scene scene = test::dots();
  scene.board.n_cores = 2;
  return scene;
}

std::unique_ptr<FramePath> path_of(const test::Scene& scene, ClockFunction clock) {
  return FramePath::configure(scene.board, CalibrationFile::load(scene.calibration).value(), clock).value();
}

struct Run {
  const test::Scene& scene;
  Exchange& exchange;
  const Clock& clock;
  ClockFunction path_clock;
  std::function<CaptureStatus(FramePool::Buffer&)> next_frame;
  std::function<void()> when_woken = [] {};
};

// Until the camera ends and its frames are done. Returns what the host reads.
Bytes play(Run run) {
  n_frame_threads = 0;
  const std::string folder = testing::TempDir() + "live_two_cores_store" + std::to_string(::getpid());
  test::FakeRandom random;
  Bytes out;
  std::atomic<bool> is_over{false};
  std::atomic<bool> stop{false};
  {
    Calibrator calibrator(run.scene.board, "0000", SlotStore::open(folder).value(), run.exchange);
    const auto next = [&](FramePool::Buffer& buffer) {
      const CaptureStatus status = run.next_frame(buffer);
      if (status == CaptureStatus::kEnd) {
        (void)test::wait_until([&] { return ended(run.exchange) == run.exchange.frames_captured; });
        is_over = true;
      }
      return status;
    };
    // Where the clock stands still the daemon never finds the line quiet, so it is stopped here.
    const auto stop_if_over = [&] { stop = is_over.load(); };
    Daemon daemon(run.scene.board, path_of(run.scene, run.path_clock),
                  DaemonDevices{.clock = run.clock,
                                .random = random,
                                .camera = std::make_unique<LiveCamera>(next),
                                .link = std::make_unique<OpenLine>(out, run.when_woken, stop_if_over),
                                .io = std::make_unique<QuietIo>()},
                  calibrator, run.exchange,
                  DeviceIdentity{.serial = "0000", .version = "test", .stream_flags = kSimulated},
                  DaemonOptions{.on_thread_start = [](const char* role) {
                    my_place = std::string(role) == "frame" ? n_frame_threads++ : kOther;
                  }});
    daemon.run(stop);
  }
  std::filesystem::remove_all(folder);
  return out;
}

// ---- dropped frames ----------------------------------------------------------------------------

constexpr int kBurst = 6;             // frames at once: one is taken, one waits, the others are replaced
constexpr uint64_t kFirstTouch = 24;  // frame
constexpr uint64_t kStepUs = 100;     // so little that no result is repeated as stale, and the rate is not judged

// Time passes with the camera's frames.
class CameraClock final : public Clock {
 public:
  [[nodiscard]] uint64_t now_us() const override { return us; }
  std::atomic<uint64_t> us{1'000'000};  // NOLINT(misc-non-private-member-variables-in-classes)
};

std::atomic<bool> is_held{false};  // both frame threads, in their next stage
uint64_t holding_clock() {
  (void)test::wait_until([] { return !is_held; });
  return 0;
}

constexpr ruffini_MessageType kTypes[] = {
    ruffini_MessageType_MESSAGE_TYPE_WRENCH, ruffini_MessageType_MESSAGE_TYPE_FIELD,
    ruffini_MessageType_MESSAGE_TYPE_MARKERS, ruffini_MessageType_MESSAGE_TYPE_IMAGE};

// No two frames are equal.
Bytes picture(const test::Scene& scene, uint64_t number) {
  const bool is_rest = number < kFirstTouch || number / 4 % 2 == 0;
  Bytes pixels = is_rest ? scene.rest : scene.pressed;
  for (size_t k = number % 7; k < pixels.size(); k += 7) pixels[k] ^= 1;
  for (size_t k = 0; k < 8; ++k) pixels[k] = static_cast<uint8_t>(number >> k & 1 ? 90 : 130);
  return pixels;
}

struct Result {
  ruffini_MessageType type{};
  Bytes payload;
  bool operator==(const Result&) const = default;
};

std::vector<Result> results_in(const Bytes& bytes) {
  std::vector<Result> out;
  FrameDecoder decoder;
  for (const uint8_t byte : bytes) {
    const auto frame = decoder.push(byte);
    if (!frame) continue;
    if (frame->header.fragment == 0) out.push_back({static_cast<ruffini_MessageType>(frame->header.type), {}});
    out.back().payload.insert(out.back().payload.end(), frame->payload.begin(), frame->payload.end());
  }
  return out;
}

// Frames are lost in the sensor, damaged, delivered twice, and come faster than they can be processed.
TEST(LiveTwoCores, EveryResultIsOfItsOwnFrameAndInOrderWhereFramesAreDropped) {
  const test::Scene scene = two_core_dots();
  constexpr uint64_t kRounds = 40;
  Exchange exchange;
  for (const ruffini_MessageType type : kTypes) exchange.every[type] = 1;
  CameraClock clock;
  struct Stamp {
    uint64_t number;
    uint64_t capture_us;
  };
  std::vector<Stamp> processed;  // by the second thread
  uint64_t number = 0, n_given = 0, n_lost = 0, n_damaged = 0, n_twice = 0;
  const auto give = [&](FramePool::Buffer& buffer) {
    clock.us += kStepUs;
    buffer.pixels = picture(scene, number);
    buffer.number = number++;
    buffer.capture_us = clock.us;
    ++n_given;
    return CaptureStatus::kFrame;
  };
  uint64_t in_round = 0, round = 0;
  // Waits until at most so many frames have not ended.
  const auto wait_for_all_but = [&](uint64_t n) {
    return test::wait_until([&] { return ended(exchange) + n >= n_given; });
  };
  const auto next = [&](FramePool::Buffer& buffer) {
    if (number < kFirstTouch) {  // rest is learned
      return wait_for_all_but(0) ? give(buffer) : CaptureStatus::kEnd;
    }
    if (in_round == 0) {
      // In every second round all frames before have ended.
      if (round % 2 == 0 && !wait_for_all_but(0)) return CaptureStatus::kEnd;
      is_held = true;
    }
    if (in_round == kBurst) is_held = false;
    // The frames after the burst come when there is room for them.
    if (in_round >= kBurst && !wait_for_all_but(1)) return CaptureStatus::kEnd;
    if (round == kRounds) {
      is_held = false;
      return CaptureStatus::kEnd;
    }
    switch (in_round++) {
      case kBurst:
        number += round % 3;  // lost in the sensor
        n_lost += round % 3;
        return give(buffer);
      case kBurst + 1:
        ++n_given;
        ++n_damaged;
        return CaptureStatus::kInvalidFrame;
      case kBurst + 2:
        ++n_twice;
        --number;
        return give(buffer);
      case kBurst + 3:
        return CaptureStatus::kNothing;
      case kBurst + 4:
        in_round = 0;
        ++round;
        return give(buffer);
      default:
        return give(buffer);
    }
  };
  const Bytes line = play({.scene = scene,
                           .exchange = exchange,
                           .clock = clock,
                           .path_clock = holding_clock,
                           .next_frame = next,
                           .when_woken = [&] {
                             EXPECT_EQ(my_place, kSecond);
                             processed.push_back({exchange.last_frame.number, exchange.last_frame.capture_us});
                           }});

  EXPECT_EQ(exchange.frames_captured, n_given);
  EXPECT_EQ(exchange.frames_invalid, n_damaged);
  EXPECT_EQ(exchange.frames_repeated, n_twice);
  EXPECT_EQ(exchange.frames_left_out, 0U);
  EXPECT_GE(exchange.frames_overrun, kRounds * (kBurst - 2));
  EXPECT_EQ(exchange.frames_processed, processed.size());
  EXPECT_EQ(n_given, ended(exchange));
  EXPECT_EQ(exchange.frames_missed, n_lost);
  EXPECT_GE(processed.size(), kFirstTouch + kRounds / 2) << "at least the last of each second round";

  // One core, on the frames that were processed: the same bytes.
  test::Scene alone = scene;
  alone.board.n_cores = 1;
  const auto path = path_of(alone, holding_clock);
  path->set_live(true);
  MessageEncoder encoder(*path, 0);
  Bytes frames;
  const auto collect = [&](ruffini_MessageType, std::span<const uint8_t> bytes) {
    frames.insert(frames.end(), bytes.begin(), bytes.end());
  };
  uint64_t next_number = 0;
  for (const Stamp& stamp : processed) {
    ASSERT_GE(stamp.number, next_number);
    next_number = stamp.number + 1;
    const Bytes pixels = picture(scene, stamp.number);
    const int width = scene.board.camera.width_px;
    const FrameView view{pixels.data(), width, scene.board.camera.height_px, 3, ptrdiff_t{3} * width};
    path->process(view, stamp.capture_us);
    for (const ruffini_MessageType type : kTypes) {
      encoder.encode(type, *path, view, {stamp.capture_us, stamp.number, path->calibration_id(), kSimulated}, collect);
    }
  }
  const std::vector<Result> expected = results_in(frames);
  // On a busy computer a newer message may take the place of one that waits for the line.
  const std::vector<Result> sent = results_in(line);
  for (const ruffini_MessageType type : kTypes) {
    auto at = expected.begin();
    uint64_t n = 0;
    for (const Result& result : sent) {
      if (result.type != type) continue;
      at = std::find(at, expected.end(), result);
      ASSERT_NE(at, expected.end()) << "message " << n << " of type " << type << " is of no frame, or out of order";
      ++at;
      ++n;
    }
    EXPECT_GT(n, 0U) << type;
  }
}

// ---- rate --------------------------------------------------------------------------------------

constexpr uint64_t kPeriodUs = 100'000;

// Time passes only where a test says so.
struct Work {
  std::atomic<uint64_t> us[2] = {};         // of a frame in each of the two frame threads
  std::atomic<bool> is_second_late{false};  // it takes a frame only when the first has done its part of the next
  std::atomic<uint64_t> n_looks{0};         // of the first thread at the clock: two a frame
  std::atomic<uint64_t> n_begun{0};         // frames that the second thread has begun to work on
  std::atomic<uint64_t> n_frames{0};        // of the camera in all
  std::atomic<bool> was_too_late{false};
} work;

// Waits until the first thread has ended its part of the next frame and has looked at the clock.
void wait_for_first(uint64_t frame) {
  if (frame + 1 >= work.n_frames || work.was_too_late) return;
  const auto until = std::chrono::steady_clock::now() + 20s;
  while (work.n_looks < 2 * (frame + 2)) {
    if (std::chrono::steady_clock::now() > until) {
      work.was_too_late = true;
      return;
    }
    std::this_thread::yield();
  }
}

class WorkClock final : public Clock {
 public:
  [[nodiscard]] uint64_t now_us() const override {
    ++n_looks;
    if (my_place == kSecond && work.is_second_late && n_looks == n_between) wait_for_first(work.n_begun);
    const uint64_t now = us;
    if (my_place == kFirst) ++work.n_looks;
    return now;
  }
  // The frame path's: a frame thread does its part where it first asks for this time after a look at the clock.
  static uint64_t work_if_new() {
    if (my_place == kOther || n_looks == 0) return 0;
    n_between = std::exchange(n_looks, 0);
    if (my_place == kSecond) ++work.n_begun;
    us += work.us[my_place];
    return 0;
  }
  static std::atomic<uint64_t> us;

 private:
  // Of this thread: since its last part, and between its two last parts. The last of them is when it takes a frame.
  static thread_local int n_looks;
  static thread_local int n_between;
};
std::atomic<uint64_t> WorkClock::us{0};
thread_local int WorkClock::n_looks = 0;
thread_local int WorkClock::n_between = 0;

class LiveTwoCoresRate : public testing::Test {
 protected:
  LiveTwoCoresRate() : scene_(two_core_dots()) {
    scene_.board.camera.rate_mhz = 1'000'000'000 / kPeriodUs;
    WorkClock::us = 1'000'000;
    work.is_second_late = false;
    work.was_too_late = false;
    work.n_looks = 0;
    work.n_begun = 0;
  }

  // `before`: called by the camera before it gives a frame; false: it ends.
  void run(uint64_t n_frames, const std::function<bool(uint64_t)>& before) {
    work.n_frames = n_frames;
    const WorkClock clock;
    uint64_t number = 0;
    play({.scene = scene_,
          .exchange = exchange_,
          .clock = clock,
          .path_clock = WorkClock::work_if_new,
          .next_frame = [&](FramePool::Buffer& buffer) {
            if (number == n_frames || !before(number)) return CaptureStatus::kEnd;
            WorkClock::us += 1;
            buffer.pixels = scene_.rest;
            buffer.pixels[number % buffer.pixels.size()] ^= 1;
            buffer.number = number++;
            buffer.capture_us = WorkClock::us;
            return CaptureStatus::kFrame;
          }});
    EXPECT_EQ(exchange_.frames_captured, n_frames);
    EXPECT_EQ(exchange_.frames_overrun, 0U);
  }
  // One frame after the other, a period of the camera apart.
  bool wait_for_all(uint64_t number) {
    if (!wait_for_ended(number)) return false;
    last_us_ += kPeriodUs;
    WorkClock::us = last_us_ = std::max(last_us_, WorkClock::us.load());
    return true;
  }
  bool wait_for_ended(uint64_t number) {
    return test::wait_until([&] { return ended(exchange_) >= number; });
  }

  test::Scene scene_;
  Exchange exchange_;
  uint64_t last_us_ = 1'000'000;
};

TEST_F(LiveTwoCoresRate, IsHalvedWhereOnlyTheFirstThreadIsSlowAndComesBack) {
  constexpr uint64_t kSlow = 40;  // frames: more than two windows of a second
  std::vector<uint32_t> divisors;
  run(240, [&](uint64_t number) {
    if (!wait_for_all(number)) return false;
    work.us[kFirst] = number < kSlow ? 120'000 : 70'000;
    work.us[kSecond] = 20'000;
    divisors.push_back(exchange_.rate_divisor);
    return true;
  });
  ASSERT_EQ(divisors.size(), 240U);
  EXPECT_EQ(divisors[12], 1U) << "after one window";
  EXPECT_EQ(divisors[kSlow], 2U);
  EXPECT_EQ(divisors[kSlow + 80], 2U) << "after eight windows in which it is fast";
  EXPECT_EQ(divisors.back(), 1U);
  EXPECT_GT(exchange_.frames_left_out, 0U);
}

TEST_F(LiveTwoCoresRate, IsKeptWhereBothThreadsTogetherTakeLongerThanAnInterval) {
  work.us[kFirst] = 80'000;
  work.us[kSecond] = 80'000;
  run(80, [&](uint64_t number) { return wait_for_all(number); });
  EXPECT_EQ(exchange_.rate_divisor, 1U);
  EXPECT_EQ(exchange_.frames_left_out, 0U);
}

// The first thread takes 60 ms for its part of a frame, then waits for 50 ms until the second has ended the frame
// before.
TEST_F(LiveTwoCoresRate, IsKeptWhereTheFirstThreadWaitsForTheSecond) {
  constexpr uint64_t kFrames = 100;
  work.us[kFirst] = 60'000;
  work.us[kSecond] = 50'000;
  const auto first_late = static_cast<uint64_t>(scene_.board.n_rest_frames) + 2;  // a frame that learns rest is alone
  run(kFrames, [&](uint64_t number) {
    if (number <= first_late && !wait_for_ended(number)) return false;
    if (number == first_late) work.is_second_late = true;
    // Until the first thread has done its part of the frame before.
    return test::wait_until([&] { return work.n_looks + 2 * exchange_.frames_left_out >= 2 * number; });
  });
  EXPECT_FALSE(work.was_too_late) << "the first thread looked at the clock only when its wait was over";
  EXPECT_EQ(exchange_.rate_divisor, 1U);
  EXPECT_EQ(exchange_.frames_left_out, 0U);
  EXPECT_EQ(exchange_.frames_processed, kFrames);
}

}  // namespace
}  // namespace ruffini
