// Records how the previous run ended, in a small file beside the calibrations: 64 bytes with a CRC-32C, written at
// start, at the end, and by the handler of fatal signals. It is never synced: a power cut may lose or damage it, which
// the CRC and the record of the start reveal.
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
  std::string thread;  // name of the thread that crashed
  std::string stuck;   // name of the thread that the watchdog waited for
  uint64_t uptime_us = 0;
  std::string calibration_id;  // 4 bytes, or empty
  uint32_t crashes = 0;        // consecutive, each within kSoonUs of its start
};

class RunRecord {
 public:
  static constexpr uint64_t kSoonUs = 20'000'000;
  static constexpr uint32_t kSafeAfter = 3;  // crashes in a row

  // Reads the record of the last run in `folder` and begins that of this run. Keeps no record if the folder cannot be
  // written. At most one object may exist at a time; it handles the signals SEGV, BUS, FPE, ILL and ABRT.
  explicit RunRecord(const std::string& folder);
  ~RunRecord();  // records an orderly stop
  RunRecord(const RunRecord&) = delete;
  RunRecord& operator=(const RunRecord&) = delete;

  [[nodiscard]] const std::optional<LastRun>& last() const { return last_; }
  [[nodiscard]] bool is_safe_mode() const { return last_ && last_->crashes >= kSafeAfter; }
  // Any thread. Stores the calibration that a later crash report names.
  static void note_calibration(uint32_t id);
  static void note_stuck(const char* thread);
  // Sets the name of the calling thread for crash reports.
  static void name_thread(const char* name);

 private:
  std::optional<LastRun> last_;
};

}  // namespace ruffini
