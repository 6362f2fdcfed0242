// What the frame thread costs the kernel: the real daemon with a live camera over a real pty, with subscriptions of a
// usual host.
//
// A seccomp filter on the frame thread alone makes a signal of each of its system calls; the handler counts it and
// makes it in its place, under a sixth argument that the filter lets through. Page faults are getrusage's, of this
// thread. The camera waits until the thread sleeps: the dearest case. RUFFINI_SOAK: a million frames.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/futex.h>
#include <linux/seccomp.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <ucontext.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <mutex>
#include <thread>

#include "daemon.h"
#include "hw/system.h"
#include "hw/thermometer.h"
#include "link/serial_port.h"
#include "support/scenes.h"
#include "support/wait_until.h"

namespace ruffini {
namespace {

constexpr uint32_t kOurs = 0x72756666;  // the sixth argument of calls that are not the thread's own
constexpr uint64_t kWarmFrames = 50;    // rest is learned, every branch was taken, every page touched
// Of camera.rate_mhz: on a busy computer the governor would leave out frames of a faster camera, and SlowCamera waits
// for each.
constexpr int64_t kSlowestRateMhz = 100;

std::atomic<uint64_t> n_calls{0};
std::atomic<uint64_t> n_lock_waits{0};
std::atomic<uintptr_t> mailbox_begin{0};  // futexes in there are the wait for a frame
std::atomic<uintptr_t> mailbox_end{0};

#if defined(__x86_64__)
constexpr bool kCanCount = true;
std::array<long, 6> arguments_of(const ucontext_t& c) {
  const auto& r = c.uc_mcontext.gregs;
  return {r[REG_RDI], r[REG_RSI], r[REG_RDX], r[REG_R10], r[REG_R8], r[REG_R9]};
}
void set_result(ucontext_t& c, long result) { c.uc_mcontext.gregs[REG_RAX] = result; }
#elif defined(__aarch64__)
constexpr bool kCanCount = true;
std::array<long, 6> arguments_of(const ucontext_t& c) {
  std::array<long, 6> out{};
  for (size_t i = 0; i < 6; ++i) out[i] = static_cast<long>(c.uc_mcontext.regs[i]);
  return out;
}
void set_result(ucontext_t& c, long result) { c.uc_mcontext.regs[0] = static_cast<unsigned long long>(result); }
#else
constexpr bool kCanCount = false;
std::array<long, 6> arguments_of(const ucontext_t&) { return {}; }
void set_result(ucontext_t&, long) {}
#endif

void on_call(int, siginfo_t* info, void* context) {
  const int saved = errno;
  auto& c = *static_cast<ucontext_t*>(context);
  const auto a = arguments_of(c);
  n_calls.fetch_add(1, std::memory_order_relaxed);
  if (info->si_syscall == SYS_futex && (a[1] & FUTEX_CMD_MASK) == FUTEX_WAIT) {
    const auto at = static_cast<uintptr_t>(a[0]);
    if (at < mailbox_begin || at >= mailbox_end) n_lock_waits.fetch_add(1, std::memory_order_relaxed);
  }
  const long result = ::syscall(info->si_syscall, a[0], a[1], a[2], a[3], a[4], long{kOurs});
  set_result(c, result < 0 ? -errno : result);
  errno = saved;
}

// From now on each system call of this thread is counted.
void count_my_calls() {
  const auto allow_if = [](uint32_t value) {
    return std::array<sock_filter, 2>{sock_filter BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, value, 0, 1),
                                      sock_filter BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW)};
  };
  std::vector<sock_filter> filter;
  filter.push_back(BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, nr)));
  // The handler's way back, and the end of a thread, when signals are off already.
  for (const long nr : {SYS_rt_sigreturn, SYS_exit, SYS_exit_group, SYS_madvise, SYS_rt_sigprocmask}) {
    for (const sock_filter& f : allow_if(static_cast<uint32_t>(nr))) filter.push_back(f);
  }
  filter.push_back(BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(seccomp_data, args) + 5 * sizeof(uint64_t)));
  for (const sock_filter& f : allow_if(kOurs)) filter.push_back(f);
  filter.push_back(BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_TRAP));
  const sock_fprog program{static_cast<unsigned short>(filter.size()), filter.data()};
  ASSERT_EQ(::prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0), 0);
  ASSERT_EQ(::prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program), 0) << "no seccomp here";
}

struct Kernel {
  uint64_t calls = 0;
  uint64_t lock_waits = 0;
  long minor_faults = 0;
  long major_faults = 0;
};

Kernel so_far() {
  rusage use{};
  ::syscall(SYS_getrusage, RUSAGE_THREAD, &use, 0, 0, 0, long{kOurs});
  return {n_calls, n_lock_waits, use.ru_minflt, use.ru_majflt};
}

// What the clock of the frame path does; only the frame thread calls it.
struct Watch {
  const Exchange* exchange = nullptr;
  uint64_t n_frames = 0;
  bool is_counting = false;
  bool is_warm = false;
  Kernel before;
  Kernel after;
  // Planted: what a frame loop must not do.
  bool plants = false;
  uint64_t planted_at = 0;
  volatile uint8_t* fresh_pages = nullptr;
  std::mutex lock;
} watch;

void plant(uint64_t frame) {
  if (frame <= kWarmFrames || frame == watch.planted_at) return;
  watch.planted_at = frame;
  for (int i = 0; i < 4; ++i) (void)::getppid();
  watch.fresh_pages[4'096 * frame] = 1;
  const std::lock_guard<std::mutex> wait(watch.lock);
}

uint64_t watching_clock() {
  const uint64_t n = watch.exchange->frames_processed;
  if (!watch.is_counting) {
    watch.is_counting = true;
    count_my_calls();
  }
  if (watch.plants) plant(n);
  if (n == kWarmFrames && !watch.is_warm) {
    watch.is_warm = true;
    watch.before = so_far();
  }
  if (n + 1 == watch.n_frames) watch.after = so_far();
  return n;
}

// Live: the next frame is there when the frame thread has slept for a while.
class SlowCamera : public Camera {
 public:
  SlowCamera(const test::Scene& scene, const Exchange& exchange, uint64_t n_frames)
      : scene_(scene), exchange_(exchange), n_frames_(n_frames) {}
  CaptureStatus capture(FramePool::Buffer& buffer) override {
    if (n_ == n_frames_) return CaptureStatus::kEnd;
    // One that was not used, because the machine stood still for a second, is not waited for.
    std::this_thread::sleep_for(std::chrono::microseconds(20));
    if (!test::wait_until([&] { return exchange_.frames_processed + exchange_.frames_repeated >= n_; },
                          std::chrono::microseconds(20))) {
      return CaptureStatus::kEnd;
    }
    std::this_thread::sleep_for(std::chrono::microseconds(20));
    const bool is_rest = n_ < static_cast<uint64_t>(scene_.board.n_rest_frames) || n_ / 4 % 2 == 0;
    buffer.pixels = is_rest ? scene_.rest : scene_.pressed;
    buffer.number = n_++;
    buffer.capture_us = clock_.now_us();
    return CaptureStatus::kFrame;
  }
  [[nodiscard]] bool is_simulated() const override { return true; }
  [[nodiscard]] bool is_replay() const override { return false; }

 private:
  const test::Scene& scene_;
  const Exchange& exchange_;
  const SystemClock clock_;
  uint64_t n_frames_;
  uint64_t n_ = 0;
};

Kernel run_daemon(uint64_t n_frames, bool plants, bool does_host_read = true) {
  struct sigaction action{};
  action.sa_sigaction = on_call;
  action.sa_flags = SA_SIGINFO;
  EXPECT_EQ(::sigaction(SIGSYS, &action, nullptr), 0);
  test::Scene scene = test::dots();
  scene.board.camera.rate_mhz = kSlowestRateMhz;
  Exchange exchange;
  for (const auto& [type, every] : {std::pair{ruffini_MessageType_MESSAGE_TYPE_WRENCH, 1U},
                                    {ruffini_MessageType_MESSAGE_TYPE_FIELD, 1U},
                                    {ruffini_MessageType_MESSAGE_TYPE_CONTACTS, 1U},
                                    {ruffini_MessageType_MESSAGE_TYPE_MARKERS, 4U},
                                    {ruffini_MessageType_MESSAGE_TYPE_DEPTH, 8U},
                                    {ruffini_MessageType_MESSAGE_TYPE_RESIDUAL, 8U},
                                    {ruffini_MessageType_MESSAGE_TYPE_IMAGE, 32U}}) {
    exchange.every[static_cast<size_t>(type)] = every;
  }
  watch.exchange = &exchange;
  watch.n_frames = n_frames;
  watch.is_counting = watch.is_warm = false;
  watch.plants = plants;
  auto path = FramePath::configure(scene.board, CalibrationFile::load(scene.calibration).value(), watching_clock);
  const std::string folder = testing::TempDir() + "frame_loop_store" + std::to_string(::getpid());
  Calibrator calibrator(scene.board, "0000", SlotStore::open(folder).value(), exchange);
  auto port = std::make_unique<SerialPort>(SerialPort::open("pty").value());
  const int host = ::open(port->host_path().c_str(), O_RDONLY | O_NOCTTY);
  EXPECT_GE(host, 0);
  const SystemClock clock;
  SystemRandom random;
  auto daemon = std::make_unique<Daemon>(
      scene.board, std::move(path).value(),
      DaemonDevices{.clock = clock,
                    .random = random,
                    .camera = std::make_unique<SlowCamera>(scene, exchange, n_frames),
                    .link = std::move(port),
                    .io = std::make_unique<Thermometer>("")},
      calibrator, exchange, DeviceIdentity{.serial = "0000", .version = "test", .stream_flags = kSimulated},
      DaemonOptions{});
  mailbox_begin = reinterpret_cast<uintptr_t>(daemon.get());
  mailbox_end = mailbox_begin + sizeof(Daemon);
  std::thread reader([&] {
    std::vector<uint8_t> bytes(65'536);
    while (does_host_read && ::read(host, bytes.data(), bytes.size()) > 0) continue;
  });
  std::atomic<bool> is_over{false};
  std::thread holder([&] {  // of the planted lock
    while (plants && !is_over) {
      {
        const std::lock_guard<std::mutex> hold(watch.lock);
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
      // Taken again at once, the lock would never be the waiting thread's.
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  });
  std::atomic<bool> stop{false};
  std::thread stopper([&] {  // the end of a line that takes nothing is waited for
    if (does_host_read) return;
    // Each frame has the whole limit.
    for (uint64_t n = 1; n <= n_frames; ++n) {
      const auto is_done = [&] { return exchange.frames_processed + exchange.frames_repeated >= n; };
      if (!test::wait_until(is_done, std::chrono::milliseconds(1))) break;
    }
    stop = true;
  });
  daemon->run(stop);
  stopper.join();
  is_over = true;
  EXPECT_TRUE(does_host_read || exchange.telemetry_dropped > n_frames) << "three messages a frame, of which one waits";
  holder.join();
  EXPECT_EQ(exchange.frames_processed, n_frames);
  EXPECT_EQ(exchange.frames_overrun, 0U);
  daemon.reset();  // closes the line: the reader ends
  reader.join();
  ::close(host);
  std::filesystem::remove_all(folder);
  return {watch.after.calls - watch.before.calls, watch.after.lock_waits - watch.before.lock_waits,
          watch.after.minor_faults - watch.before.minor_faults, watch.after.major_faults - watch.before.major_faults};
}

TEST(FrameLoop, TroublesTheKernelNoMoreThanToSleepAndToBeWoken) {
  if (!kCanCount) GTEST_SKIP() << "system calls are counted on x86-64 and aarch64";
  const uint64_t n_frames = std::getenv("RUFFINI_SOAK") != nullptr ? 1'000'000 : 2'000;
  const Kernel out = run_daemon(n_frames, false);
  const uint64_t n = n_frames - kWarmFrames - 1;
  std::printf("%llu frames: %.3f system calls a frame, %llu waits for a lock, %ld minor and %ld major page faults\n",
              static_cast<unsigned long long>(n), static_cast<double>(out.calls) / static_cast<double>(n),
              static_cast<unsigned long long>(out.lock_waits), out.minor_faults, out.major_faults);
  EXPECT_LE(out.calls, 3 * n);
  EXPECT_GE(out.calls, n / 2) << "the thread never slept: nothing was counted";
  EXPECT_EQ(out.lock_waits, 0U);
  EXPECT_EQ(out.minor_faults, 0);
  EXPECT_EQ(out.major_faults, 0);
}

TEST(FrameLoop, AHostThatDoesNotReadCostsTheFrameThreadNothing) {
  if (!kCanCount) GTEST_SKIP() << "system calls are counted on x86-64 and aarch64";
  constexpr uint64_t kFrames = 1'000;
  const Kernel out = run_daemon(kFrames, false, false);
  EXPECT_LE(out.calls, 3 * kFrames);
  EXPECT_GE(out.calls, kFrames / 2) << "the thread never slept: nothing was counted";
  EXPECT_EQ(out.lock_waits, 0U);
  EXPECT_EQ(out.minor_faults, 0);
}

TEST(FrameLoop, PlantedCallsPagesAndLocksAreSeen) {
  if (!kCanCount) GTEST_SKIP() << "system calls are counted on x86-64 and aarch64";
  constexpr uint64_t kFrames = 100;
  constexpr size_t kBytes = 4'096 * (kFrames + 1);
  void* pages = ::mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  ASSERT_NE(pages, MAP_FAILED);
  watch.fresh_pages = static_cast<volatile uint8_t*>(pages);
  const Kernel out = run_daemon(kFrames, true);
  EXPECT_GT(out.calls, 3 * kFrames / 2);
  EXPECT_GT(out.lock_waits, 0U);
  EXPECT_GE(out.minor_faults, static_cast<long>(kFrames - kWarmFrames) / 2);
  ::munmap(pages, kBytes);
}

}  // namespace
}  // namespace ruffini
