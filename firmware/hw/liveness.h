// Whether every thread has moved on since the watchdog was last fed.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace ruffini {

// What a thread has done so far, in any unit that only grows; it need not move on while nothing is expected of it.
struct ThreadProgress {
  const char* name = "";
  uint64_t count = 0;
  bool is_expected = false;
};

template <size_t n_threads>
class Liveness {
 public:
  // The manager wants to hear every `watchdog_us`; 0: never. It does three times as often.
  explicit Liveness(uint64_t watchdog_us) : interval_us_(watchdog_us / 3) {}

  // True: feed now. To be called a few times in an interval.
  [[nodiscard]] bool update(const std::array<ThreadProgress, n_threads>& threads, uint64_t now_us) {
    if (interval_us_ == 0) return false;
    if (fed_us_ != 0 && now_us - fed_us_ < interval_us_) return false;
    stuck_ = "";
    for (size_t i = 0; i < n_threads; ++i) {
      if (threads[i].is_expected && threads[i].count == last_[i]) stuck_ = threads[i].name;
    }
    if (*stuck_ != '\0') return false;
    for (size_t i = 0; i < n_threads; ++i) last_[i] = threads[i].count;
    fed_us_ = now_us;
    return true;
  }
  // The thread that the watchdog waits for; empty: none.
  [[nodiscard]] const char* stuck() const { return stuck_; }

 private:
  uint64_t interval_us_;
  uint64_t fed_us_ = 0;
  std::array<uint64_t, n_threads> last_{};
  const char* stuck_ = "";
};

}  // namespace ruffini
