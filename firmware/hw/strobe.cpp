#include "hw/strobe.h"

#include <algorithm>
#include <chrono>

namespace ruffini {
namespace {

using SteadyClock = std::chrono::steady_clock;

uint64_t now_us() {
  return static_cast<uint64_t>(
      std::chrono::duration_cast<std::chrono::microseconds>(SteadyClock::now().time_since_epoch()).count());
}

}  // namespace

StrobePlan::StrobePlan(uint64_t period_us, uint64_t exposure_us)
    : period_us_(period_us),
      exposure_us_(std::min(exposure_us, period_us)),
      guard_us_((period_us - exposure_us_) / 8) {}

std::optional<uint64_t> StrobePlan::next_us(uint64_t now_us) const {
  if (middle_us_ == 0) return std::nullopt;
  const uint64_t first_us = middle_us_ + period_us_ - exposure_us_ / 2 - guard_us_;
  if (now_us < first_us) return first_us;
  return first_us + ((now_us - first_us) / period_us_ + 1) * period_us_;
}

void StrobePlan::switched(uint64_t at_us, bool is_on) {
  switches_[n_switches_ % switches_.size()] = {at_us, is_on};
  ++n_switches_;
}

std::optional<bool> StrobePlan::lamps_during(uint64_t middle_us) const {
  const uint64_t begin_us = middle_us - std::min(middle_us, exposure_us_ / 2);
  const uint64_t end_us = middle_us + period_us_ - exposure_us_ / 2 - 2 * guard_us_;
  const size_t n = std::min(n_switches_, switches_.size());
  for (size_t i = 1; i <= n; ++i) {  // newest first
    const Switch& one = switches_[(n_switches_ - i) % switches_.size()];
    if (one.at_us > end_us) continue;
    if (one.at_us > begin_us) return std::nullopt;
    return one.is_on;
  }
  return std::nullopt;
}

Strobe::Strobe(OutputLine& line, uint64_t period_us, uint64_t exposure_us)
    : line_(line), plan_(period_us, exposure_us), thread_([this] { loop(); }) {}

Strobe::~Strobe() {
  {
    const std::lock_guard lock(mutex_);
    is_ending_ = true;
  }
  changed_.notify_one();
  thread_.join();
}

std::optional<bool> Strobe::record_frame(uint64_t middle_us) {
  const std::lock_guard lock(mutex_);
  plan_.record_frame(middle_us);
  changed_.notify_one();
  return plan_.lamps_during(middle_us);
}

void Strobe::loop() {
  bool is_on = true;
  std::unique_lock lock(mutex_);
  uint64_t done_us = 0;  // prevents a repeated switch if the synchronization shifts slightly
  while (!is_ending_) {
    const std::optional<uint64_t> next_us = plan_.next_us(std::max(now_us(), done_us));
    if (!next_us) {
      changed_.wait(lock);
      continue;
    }
    const SteadyClock::time_point due{std::chrono::microseconds(*next_us)};
    changed_.wait_until(lock, due);
    // Woken by a new frame or the end. Not if the switch came due meanwhile: the plan would return the switch after it.
    if (is_ending_ || now_us() < *next_us) continue;
    if (line_.set(!is_on)) {
      is_on = !is_on;
      plan_.switched(now_us(), is_on);
    }
    done_us = *next_us + plan_.period_us() / 4;
  }
}

}  // namespace ruffini
