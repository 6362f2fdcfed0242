#include "store/last_run.h"

#include <fcntl.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <cstring>
#include <span>
#include <type_traits>

#include "base/crc32c.h"

namespace ruffini {
namespace {

constexpr char kName[] = "last-run";
constexpr uint32_t kMagic = 0x314E5552;  // "RUN1"
constexpr uint32_t kRunning = 3;         // no end has been recorded yet
constexpr size_t kNameBytes = 16;        // length of a thread name in Linux
constexpr int kSignals[] = {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT};

struct Record {
  uint32_t magic = kMagic;
  uint32_t end = kRunning;
  uint32_t signal = 0;
  uint32_t crashes = 0;
  uint64_t uptime_us = 0;
  uint32_t calibration_id = 0;
  std::array<char, kNameBytes> thread{};
  std::array<char, kNameBytes> stuck{};
  uint32_t crc = 0;
};
static_assert(sizeof(Record) == 64 && std::is_trivially_copyable_v<Record>, "as stored, without padding");

// Data that the signal handler may access.
struct CrashRecord {
  int fd = -1;
  uint64_t started_us = 0;
  uint32_t crashes_before = 0;
  std::atomic<uint32_t> calibration_id{0};
  std::atomic<const char*> stuck{""};
};
CrashRecord crash_record;

// Async-signal-safe, as is everything that it calls.
uint64_t now_us() {
  timespec t{};
  ::clock_gettime(CLOCK_MONOTONIC, &t);
  return static_cast<uint64_t>(t.tv_sec) * 1'000'000 + static_cast<uint64_t>(t.tv_nsec) / 1'000;
}

uint32_t crc_of(const Record& record) {
  return crc32c({reinterpret_cast<const uint8_t*>(&record), offsetof(Record, crc)});
}

void write_record(uint32_t end, int signal) {
  Record record;
  record.end = end;
  record.signal = static_cast<uint32_t>(signal);
  record.uptime_us = now_us() - crash_record.started_us;
  record.calibration_id = crash_record.calibration_id;
  if (end == static_cast<uint32_t>(RunEnd::kCrashed)) {
    record.crashes = record.uptime_us < RunRecord::kSoonUs ? crash_record.crashes_before + 1 : 0;
    ::prctl(PR_GET_NAME, record.thread.data());
    std::strncpy(record.stuck.data(), crash_record.stuck.load(), kNameBytes - 1);
  }
  record.crc = crc_of(record);
  (void)!::pwrite(crash_record.fd, &record, sizeof record, 0);
}

void on_crash(int signal) {
  write_record(static_cast<uint32_t>(RunEnd::kCrashed), signal);
  ::signal(signal, SIG_DFL);
  ::raise(signal);
}

std::optional<LastRun> read_last(int fd) {
  Record record;
  if (::pread(fd, &record, sizeof record, 0) != sizeof record) return std::nullopt;
  if (record.magic != kMagic || record.crc != crc_of(record) || record.end > kRunning) return std::nullopt;
  const auto text = [](std::array<char, kNameBytes> name) {
    name.back() = '\0';
    std::replace_if(name.begin(), name.end() - 1, [](char c) { return c != '\0' && (c < ' ' || c > '~'); }, '?');
    return std::string(name.data());
  };
  LastRun last{.end = record.end == kRunning ? RunEnd::kCut : static_cast<RunEnd>(record.end),
               .signal = record.signal,
               .thread = text(record.thread),
               .stuck = text(record.stuck),
               .uptime_us = record.uptime_us,
               .calibration_id = {},
               .crashes = record.crashes};
  for (int shift = 24; shift >= 0 && record.calibration_id != 0; shift -= 8) {
    last.calibration_id.push_back(static_cast<char>(record.calibration_id >> shift));
  }
  return last;
}

}  // namespace

RunRecord::RunRecord(const std::string& folder) {
  const std::string path = folder + "/" + kName;
  crash_record.fd = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK, 0600);
  if (crash_record.fd < 0) return;
  last_ = read_last(crash_record.fd);
  crash_record.started_us = now_us();
  crash_record.crashes_before = last_ ? last_->crashes : 0;
  crash_record.calibration_id = 0;
  crash_record.stuck = "";
  write_record(kRunning, 0);
  for (const int signal : kSignals) {
    struct sigaction action{};
    action.sa_handler = on_crash;
    action.sa_flags = SA_NODEFER;
    ::sigaction(signal, &action, nullptr);
  }
}

RunRecord::~RunRecord() {
  if (crash_record.fd < 0) return;
  for (const int signal : kSignals) ::signal(signal, SIG_DFL);
  write_record(static_cast<uint32_t>(RunEnd::kStopped), 0);
  ::close(crash_record.fd);
  crash_record.fd = -1;
}

void RunRecord::note_calibration(uint32_t id) { crash_record.calibration_id = id; }
void RunRecord::note_stuck(const char* thread) { crash_record.stuck = thread; }
void RunRecord::name_thread(const char* name) { ::prctl(PR_SET_NAME, name); }

}  // namespace ruffini
