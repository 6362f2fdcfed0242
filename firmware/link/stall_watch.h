// Detects a stalled camera: no good frame for three times the usual interval, at least 25 ms. The interval is the
// board's or, if frames come more slowly, the mean of the last ones. A camera that is more than three times as slow as
// its board says would stall before each frame: after kMaxLateInARow late frames in a row the shortest of their
// intervals is the usual one. A force is old after kOldestUs whatever the camera's interval; only a board whose own
// interval is longer than a third of that waits longer. Link thread only.
#pragma once

#include <algorithm>
#include <cstdint>

namespace ruffini {

class StallWatch {
 public:
  static constexpr uint64_t kMinUs = 25'000;
  static constexpr uint64_t kFirstUs = 2'000'000;  // a camera that is starting
  static constexpr int kMaxLateInARow = 4;
  static constexpr uint64_t kOldestUs = 1'200'000;

  explicit StallWatch(uint64_t period_us) : period_us_(period_us), mean_us_(period_us) {}

  // Returns true if the camera stalls. `n_frames`: good frames since it started. Call a few times per frame.
  [[nodiscard]] bool update(uint64_t n_frames, uint64_t now_us) {
    if (since_us_ == 0) since_us_ = now_us;
    if (n_frames != n_frames_) {
      const uint64_t interval_us = (now_us - since_us_) / (n_frames - n_frames_);
      if (n_frames_ > 0) learn(interval_us);
      n_frames_ = n_frames;
      since_us_ = now_us;
      is_stalled_ = false;
    } else {
      is_stalled_ = now_us - since_us_ > limit_us();
    }
    return is_stalled_;
  }
  // No frames are expected at present.
  void suspend(uint64_t now_us) {
    since_us_ = now_us;
    is_stalled_ = false;
    n_late_ = 0;
  }
  [[nodiscard]] uint64_t silence_us(uint64_t now_us) const { return now_us - since_us_; }
  [[nodiscard]] uint64_t limit_us() const {
    return n_frames_ == 0 ? kFirstUs : std::max({3 * period_us_, std::min(3 * mean_us_, kOldestUs), kMinUs});
  }

 private:
  // A stall is not an interval, unless every frame comes that late; a delay shorter than that is normal variation.
  void learn(uint64_t interval_us) {
    if (!is_stalled_) {
      mean_us_ = (7 * mean_us_ + interval_us) / 8;
      n_late_ = 0;
      return;
    }
    shortest_late_us_ = n_late_ == 0 ? interval_us : std::min(shortest_late_us_, interval_us);
    if (++n_late_ < kMaxLateInARow) return;
    mean_us_ = shortest_late_us_;
    n_late_ = 0;
  }

  uint64_t period_us_;
  uint64_t mean_us_;
  uint64_t shortest_late_us_ = 0;
  int n_late_ = 0;
  uint64_t n_frames_ = 0;
  uint64_t since_us_ = 0;
  bool is_stalled_ = false;
};

}  // namespace ruffini
