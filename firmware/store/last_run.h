// How the run before this one ended, kept in a small file beside the calibrations: 64 bytes with a CRC-32C, written at
// the start, at the end, and by the handler of the signals that end a crashed process. Never synced: it may be lost with
// the power, and is then damaged or old, which the CRC and the start's own record tell.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>

#include "base/unique_fd.h"

namespace ruffini {

enum class RunEnd : uint32_t { kStopped = 0, kCrashed = 1, kCut = 2 };  // numbers of RunEnd in ruffini.proto

struct LastRun {
  RunEnd end = RunEnd::kStopped;
  uint32_t signal = 0;
  std::string thread;  // that crashed
  std::string stuck;   // that the watchdog waited for
  uint64_t uptime_us = 0;
  std::string calibration_id;  // 4 bytes, or empty
  uint32_t crashes = 0;        // in a row, each within kSoonUs of its start
};

class RunRecord {
 public:
  static constexpr uint64_t kSoonUs = 20'000'000;
  static constexpr uint32_t kSafeAfter = 3;  // crashes in a row

  // Reads what the last run left in `folder` and begins this run's record. A folder that cannot be written keeps none.
  // At most one object at a time; it takes the signals SEGV, BUS, FPE, ILL and ABRT.
  explicit RunRecord(const std::string& folder);
  ~RunRecord();  // stopped as it was asked to
  RunRecord(const RunRecord&) = delete;
  RunRecord& operator=(const RunRecord&) = delete;

  [[nodiscard]] const std::optional<LastRun>& last() const { return last_; }
  [[nodiscard]] bool is_safe_mode() const { return last_ && last_->crashes >= kSafeAfter; }
  // Any thread; what a crash from now on says.
  static void note_calibration(uint32_t id);
  static void note_stuck(const char* thread);
  // Of the calling thread, as a crash says it.
  static void name_thread(const char* name);

 private:
  std::optional<LastRun> last_;
};

}  // namespace ruffini
