// Checks everything that the daemon needs from this computer, with a remedy for each problem (`ruffinid --doctor`).
#pragma once

#include <string>
#include <vector>

#include "board/hardware_settings.h"
#include "hw/i2c.h"

namespace ruffini {

enum class CheckState { kOk, kWarning, kFailed };

struct Check {
  std::string name;
  CheckState state = CheckState::kOk;
  std::string found;   // the actual state
  std::string remedy;  // what to do; empty if nothing
};

struct DoctorRequest {
  std::string root;   // prefix of /dev, /sys, /proc and the paths below; empty except in tests
  std::string link;   // as --link
  std::string store;  // as --store
};

// Checks devices and permissions (of the calling user), USB port, clock, governor, throttling, temperature, memory
// lock.
[[nodiscard]] std::vector<Check> examine(const DoctorRequest& request);

// Checks priorities and CPUs of [threads] by trying each in a thread of its own.
[[nodiscard]] Check examine_threads(const ThreadsSettings& threads);

// Checks that the [led_driver] answers; switches nothing. `bus`: for tests; otherwise the board's is opened.
[[nodiscard]] Check examine_lamps(const LedDriverSettings& driver, I2cBus* bus = nullptr);

[[nodiscard]] bool has_failed(const std::vector<Check>& checks);
// One line per check, followed by its remedy.
[[nodiscard]] std::string as_text(const std::vector<Check>& checks);
// {"ok": BOOL, "checks": [{"name", "state": "ok"|"warning"|"failed", "found", "remedy"}, ...]}
[[nodiscard]] std::string as_json(const std::vector<Check>& checks);

}  // namespace ruffini
