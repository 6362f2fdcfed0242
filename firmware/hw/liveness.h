// Checks that every thread has made progress since the watchdog was last fed.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace ruffini {

// Progress of a thread in any increasing unit. It need not increase while no progress is expected.
struct ThreadProgress {
  const char* name = "";
  uint64_t count = 0;
  bool is_expected = false;
};

template <size_t n_threads>
class Liveness {
 public:
  // `watchdog_us`: the manager's timeout; 0: no watchdog. The watchdog is fed three times per timeout.
  explicit Liveness(uint64_t watchdog_us) : interval_us_(watchdog_us / 3) {}

  // Returns true if the watchdog is to be fed now. Call a few times per interval.
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
  // Name of a thread without progress; empty: none.
  [[nodiscard]] const char* stuck() const { return stuck_; }

 private:
  uint64_t interval_us_;
  uint64_t fed_us_ = 0;
  std::array<uint64_t, n_threads> last_{};
  const char* stuck_ = "";
};

}  // namespace ruffini
