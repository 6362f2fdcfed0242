// The frame thread allocates nothing: the real daemon, over a real pty, with every message subscribed.
//
// malloc and its relatives are replaced; they count what the frame thread asks for while it is in its
// loop. The frame threads are known by the clock that only the frame path calls.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <filesystem>
#include <thread>

#include "daemon.h"
#include "hw/system.h"
#include "hw/thermometer.h"
#include "link/serial_port.h"
#include "support/scenes.h"

namespace {

thread_local bool is_watched = false;
std::atomic<uint64_t> n_allocations{0};
std::atomic<bool> plants_allocation{false};

}  // namespace

// operator new of the standard library ends here, too.
extern "C" {
void* __libc_malloc(size_t size);
void* __libc_calloc(size_t n, size_t size);
void* __libc_realloc(void* p, size_t size);
void* __libc_memalign(size_t alignment, size_t size);

void* malloc(size_t size) {
  if (is_watched) n_allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_malloc(size);
}
void* calloc(size_t n, size_t size) {
  if (is_watched) n_allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_calloc(n, size);
}
void* realloc(void* p, size_t size) {
  if (is_watched) n_allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_realloc(p, size);
}
void* aligned_alloc(size_t alignment, size_t size) {
  if (is_watched) n_allocations.fetch_add(1, std::memory_order_relaxed);
  return __libc_memalign(alignment, size);
}
int posix_memalign(void** out, size_t alignment, size_t size) {
  *out = aligned_alloc(alignment, size);
  return *out == nullptr ? ENOMEM : 0;
}
}

namespace ruffini {
namespace {

constexpr uint64_t kFrames = 1'100;
constexpr uint64_t kFewFrames = 120;  // where the frame path is one that another test takes through all
constexpr uint64_t kWarmFrames = 20;  // rest is learned, every branch was taken once

std::atomic<uint64_t> clock_calls{0};
std::atomic<bool> is_warm{false};  // the next frame waits for it: allocations count from here

// Called by the frame threads alone, several times a frame.
uint64_t watching_clock() {
  is_watched = true;
  if (plants_allocation.exchange(false)) {
    auto* volatile planted = new int(1);
    delete planted;
  }
  return clock_calls.fetch_add(1, std::memory_order_relaxed);
}

// A contact that comes and goes.
class DrawnCamera : public Camera {
 public:
  DrawnCamera(const test::Scene& scene, uint64_t n_frames)
      : n_frames_(n_frames),
        n_rest_(static_cast<uint64_t>(scene.board.n_rest_frames)),
        rest_(scene.rest),
        pressed_(scene.pressed) {}
  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (n_ == n_frames_) return CaptureStatus::kEnd;
    while (n_ == kWarmFrames && !is_warm) std::this_thread::yield();
    buffer.pixels = n_ < n_rest_ || n_ / 4 % 2 == 0 ? rest_ : pressed_;
    buffer.number = n_++;
    return CaptureStatus::kFrame;
  }
  [[nodiscard]] bool is_simulated() const override { return true; }
  [[nodiscard]] bool is_replay() const override { return false; }

 private:
  uint64_t n_frames_;
  uint64_t n_rest_;
  uint64_t n_ = 0;
  std::vector<uint8_t> rest_;
  std::vector<uint8_t> pressed_;
};

struct Outcome {
  uint64_t frames = 0;
  uint64_t allocations = 0;
  size_t smallest_field = SIZE_MAX;
  size_t largest_field = 0;
  size_t smallest_contacts = SIZE_MAX;
  size_t largest_contacts = 0;
  size_t smallest_depth = SIZE_MAX;
  size_t largest_depth = 0;
  std::array<uint64_t, kMessageTypes> messages{};
};

// Runs the daemon in lockstep with a host that reads everything.
Outcome run_daemon(const test::Scene& scene, bool plants, uint64_t n_frames = kFrames,
                   const NetworkLoader& network = {}) {
  const BoardSettings& board = scene.board;
  auto file = CalibrationFile::load(scene.calibration);
  EXPECT_TRUE(file) << (file ? "" : file.error().message);
  auto path = FramePath::configure(board, file.value(), watching_clock);
  EXPECT_TRUE(path) << (path ? "" : path.error().message);
  const std::string folder = testing::TempDir() + "no_allocation_store" + std::to_string(::getpid());
  Exchange exchange;
  for (int type = ruffini_MessageType_MESSAGE_TYPE_STATUS; type <= ruffini_MessageType_MESSAGE_TYPE_IMAGE; ++type) {
    exchange.every[static_cast<size_t>(type)] = 1;
  }
  exchange.every[ruffini_MessageType_MESSAGE_TYPE_LEARNED] = 1;
  exchange.every[ruffini_MessageType_MESSAGE_TYPE_RESIDUAL] = 1;
  exchange.every[ruffini_MessageType_MESSAGE_TYPE_FEATURES] = 1;
  Calibrator calibrator(board, "0000", SlotStore::open(folder).value(), exchange);
  auto port = std::make_unique<SerialPort>(SerialPort::open("pty").value());
  const int host = ::open(port->host_path().c_str(), O_RDONLY | O_NOCTTY);
  EXPECT_GE(host, 0);
  std::atomic<bool> stop{false};
  is_warm = false;
  const SystemClock clock;
  SystemRandom random;
  Outcome out;
  auto daemon = std::make_unique<Daemon>(
      board, std::move(path).value(),
      DaemonDevices{.clock = clock,
                    .random = random,
                    .camera = std::make_unique<DrawnCamera>(scene, n_frames),
                    .link = std::move(port),
                    .io = std::make_unique<Thermometer>("")},
      calibrator, exchange,
      DeviceIdentity{.serial = "0000", .version = "test", .stream_flags = kSimulated, .is_lossless = true},
      DaemonOptions{.is_lockstep = true, .network = network});
  std::thread reader([&] {
    FrameDecoder decoder;
    std::vector<uint8_t> bytes(65'536);
    while (true) {
      const ssize_t n = ::read(host, bytes.data(), bytes.size());
      if (n <= 0) break;
      for (ssize_t i = 0; i < n; ++i) {
        const auto frame = decoder.push(bytes[static_cast<size_t>(i)]);
        if (!frame || frame->header.fragment != 0) continue;
        ++out.messages[frame->header.type];
        const size_t size = frame->payload.size();
        if (frame->header.type == ruffini_MessageType_MESSAGE_TYPE_FIELD) {
          out.smallest_field = std::min(out.smallest_field, size);
          out.largest_field = std::max(out.largest_field, size);
        } else if (frame->header.type == ruffini_MessageType_MESSAGE_TYPE_CONTACTS) {
          out.smallest_contacts = std::min(out.smallest_contacts, size);
          out.largest_contacts = std::max(out.largest_contacts, size);
        } else if (frame->header.type == ruffini_MessageType_MESSAGE_TYPE_DEPTH) {
          out.smallest_depth = std::min(out.smallest_depth, size);
          out.largest_depth = std::max(out.largest_depth, size);
        }
      }
    }
  });
  std::thread watcher([&] {
    while (exchange.frames_processed < kWarmFrames) std::this_thread::yield();
    n_allocations = 0;
    if (plants) plants_allocation = true;
    is_warm = true;
  });
  daemon->run(stop);
  watcher.join();
  out.allocations = n_allocations;
  out.frames = exchange.frames_processed;
  daemon.reset();  // closes the line: the reader ends
  reader.join();
  ::close(host);
  std::filesystem::remove_all(folder);
  return out;
}

TEST(FrameThread, AllocatesNothingInAThousandFramesWithEverythingSubscribed) {
  const Outcome out = run_daemon(test::dots(), false);
  EXPECT_EQ(out.frames, kFrames);
  EXPECT_EQ(out.allocations, 0U);
  EXPECT_GT(out.largest_field, out.smallest_field + 50) << "no contact was seen: the second pass did not run";
  for (const auto type : {ruffini_MessageType_MESSAGE_TYPE_WRENCH, ruffini_MessageType_MESSAGE_TYPE_FIELD,
                          ruffini_MessageType_MESSAGE_TYPE_DEPTH, ruffini_MessageType_MESSAGE_TYPE_CONTACTS,
                          ruffini_MessageType_MESSAGE_TYPE_MARKERS, ruffini_MessageType_MESSAGE_TYPE_IMAGE,
                          ruffini_MessageType_MESSAGE_TYPE_RESIDUAL}) {
    EXPECT_EQ(out.messages[static_cast<size_t>(type)], kFrames) << type;
  }
}

TEST(FrameThread, AllocatesNothingOnTwoCores) {
  test::Scene scene = test::dots();
  scene.board.n_cores = 2;
  const Outcome out = run_daemon(scene, false);
  EXPECT_EQ(out.frames, kFrames);
  EXPECT_EQ(out.allocations, 0U);
  EXPECT_GT(out.largest_field, out.smallest_field + 50) << "no contact was seen: the second pass did not run";
}

TEST(FrameThread, AllocatesNothingOnASkinWithTwoTouches) {
  const Outcome out = run_daemon(test::glow(), false);
  EXPECT_EQ(out.frames, kFrames);
  EXPECT_EQ(out.allocations, 0U);
  EXPECT_GT(out.largest_contacts, out.smallest_contacts + 50) << "no touch was seen";
}

TEST(FrameThread, AllocatesNothingWithAContactModelAndItsDepthMap) {
  const Outcome out = run_daemon(test::texture(), false);
  EXPECT_EQ(out.frames, kFrames);
  EXPECT_EQ(out.allocations, 0U);
  EXPECT_GT(out.largest_contacts, out.smallest_contacts + 50) << "no contact was seen";
  EXPECT_GT(out.largest_depth, out.smallest_depth + 20) << "no depth was told";
}

TEST(FrameThread, AllocatesNothingOnSpotsOfLight) {
  const Outcome out = run_daemon(test::spots(), false);
  EXPECT_EQ(out.frames, kFrames);
  EXPECT_EQ(out.allocations, 0U);
  EXPECT_EQ(out.messages[ruffini_MessageType_MESSAGE_TYPE_FEATURES], kFrames);
}

// Allocates as OpenCV does, in its own thread.
class Allocating : public Network {
 public:
  bool infer(const FrameView& frame, std::span<float> out) override {
    const std::vector<float> all(frame.data, frame.data + frame.stride * frame.height);
    out[0] = all.back();
    return true;
  }
};

TEST(FrameThread, AllocatesNothingBesideALearnedNetwork) {
  const Outcome out = run_daemon(test::glow(), false, kFewFrames, []() -> Result<LoadedNetwork> {
    return LoadedNetwork{{{"last"}, {0}, {255}, {}}, std::make_unique<Allocating>()};
  });
  EXPECT_EQ(out.frames, kFewFrames);
  EXPECT_EQ(out.allocations, 0U);
  EXPECT_EQ(out.messages[ruffini_MessageType_MESSAGE_TYPE_LEARNED], kFewFrames);
}

TEST(FrameThread, APlantedAllocationIsSeen) { EXPECT_EQ(run_daemon(test::dots(), true, kFewFrames).allocations, 1U); }

}  // namespace
}  // namespace ruffini
