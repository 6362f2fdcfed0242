// Halves the camera's rate while the board cannot keep up with it, so that frames come evenly and the board cools.
//
// In windows of a second:
//   too slow: the computer is throttled, or more than half of the frames took longer than the camera's interval;
//   fast:     it is not throttled, and at most a tenth of the frames took longer than 3/4 of that interval.
// Two windows in a row that are too slow halve the rate. Ten in a row that are fast restore it.
//
// Frame thread only.
#pragma once

#include <cstdint>

namespace ruffini {

class RateGovernor {
 public:
  static constexpr uint64_t kWindowUs = 1'000'000;
  static constexpr int kSlowWindows = 2;
  static constexpr int kFastWindows = 10;

  explicit RateGovernor(uint64_t period_us) : period_us_(period_us) {}

  // Call after each frame, which kept the frame thread busy for `busy_us`. Returns the divisor of the rate: 1 or 2.
  uint32_t update(uint64_t now_us, uint64_t busy_us, bool is_throttled) {
    if (start_us_ == 0) {
      start_us_ = now_us;
      return divisor_;
    }
    ++n_frames_;
    n_over_ += busy_us > period_us_ ? 1U : 0U;
    n_near_ += 4 * busy_us > 3 * period_us_ ? 1U : 0U;
    was_throttled_ = was_throttled_ || is_throttled;
    if (now_us - start_us_ < kWindowUs) return divisor_;
    const bool is_slow = was_throttled_ || 2 * n_over_ > n_frames_;
    const bool is_fast = !was_throttled_ && 10 * n_near_ <= n_frames_;
    const bool counts = divisor_ == 1 ? is_slow : is_fast;
    n_windows_ = counts ? n_windows_ + 1 : 0;
    if (n_windows_ >= (divisor_ == 1 ? kSlowWindows : kFastWindows)) {
      divisor_ = 3 - divisor_;
      n_windows_ = 0;
    }
    start_us_ = now_us;
    n_frames_ = n_over_ = n_near_ = 0;
    was_throttled_ = false;
    return divisor_;
  }

 private:
  uint64_t period_us_;
  uint64_t start_us_ = 0;  // of the window
  uint32_t n_frames_ = 0;  // in the window
  uint32_t n_over_ = 0;
  uint32_t n_near_ = 0;
  bool was_throttled_ = false;
  int n_windows_ = 0;  // in a row, that speak for a change
  uint32_t divisor_ = 1;
};

}  // namespace ruffini
