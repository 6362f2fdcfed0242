// Waits for another thread, but not for ever.
#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <thread>

namespace ruffini::test {

// Of real time; no computer is so busy that what a test waits for takes that long.
constexpr std::chrono::seconds kWaitLimit{120};

// Returns true when `is_met` does. After kWaitLimit the test fails and false is returned: the caller should then end.
// `pause`: between two calls; 0 lets another thread run.
template <typename Condition>
[[nodiscard]] bool wait_until(Condition is_met, std::chrono::microseconds pause = {},
                              const char* file = __builtin_FILE(), int line = __builtin_LINE()) {
  const auto end = std::chrono::steady_clock::now() + kWaitLimit;
  while (!is_met()) {
    if (std::chrono::steady_clock::now() > end) {
      ADD_FAILURE_AT(file, line) << "waited for " << kWaitLimit.count() << " s";
      return false;
    }
    pause.count() > 0 ? std::this_thread::sleep_for(pause) : std::this_thread::yield();
  }
  return true;
}

}  // namespace ruffini::test
