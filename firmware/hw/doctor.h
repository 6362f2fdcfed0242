// What the daemon needs of this computer, looked at one by one, each with its remedy (`ruffinid --doctor`).
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
  std::string found;   // what is so
  std::string remedy;  // what to do; empty where nothing
};

struct DoctorRequest {
  std::string root;   // in front of /dev, /sys, /proc and the paths below; empty but in tests
  std::string link;   // as --link
  std::string store;  // as --store
};

// Devices and permissions (of the user who asks), USB port, clock, governor, throttling, heat, memory lock.
[[nodiscard]] std::vector<Check> examine(const DoctorRequest& request);

// Priorities and CPUs of [threads], each tried by a thread of its own.
[[nodiscard]] Check examine_threads(const ThreadsSettings& threads);

// [led_driver]: whether it answers; nothing is switched. `bus`: of a test; else the board's is opened.
[[nodiscard]] Check examine_lamps(const LedDriverSettings& driver, I2cBus* bus = nullptr);

[[nodiscard]] bool has_failed(const std::vector<Check>& checks);
// A line for each check, its remedy under it.
[[nodiscard]] std::string as_text(const std::vector<Check>& checks);
// {"ok": BOOL, "checks": [{"name", "state": "ok"|"warning"|"failed", "found", "remedy"}, ...]}
[[nodiscard]] std::string as_json(const std::vector<Check>& checks);

}  // namespace ruffini
