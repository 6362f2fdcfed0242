// Detects a stalled camera: no good frame for three times the usual interval, at least 25 ms. The interval is the
// board's or, if frames come more slowly, the mean of the last ones. Link thread only.
#pragma once

#include <algorithm>
#include <cstdint>

namespace ruffini {

class StallWatch {
 public:
  static constexpr uint64_t kMinUs = 25'000;
  static constexpr uint64_t kFirstUs = 2'000'000;  // a camera that is starting

  explicit StallWatch(uint64_t period_us) : period_us_(period_us), mean_us_(period_us) {}

  // Returns true if the camera stalls. `n_frames`: good frames since it started. Call a few times per frame.
  [[nodiscard]] bool update(uint64_t n_frames, uint64_t now_us) {
    if (since_us_ == 0) since_us_ = now_us;
    if (n_frames != n_frames_) {
      const uint64_t interval_us = (now_us - since_us_) / (n_frames - n_frames_);
      // A stall is not an interval; a delay shorter than that is normal variation.
      if (n_frames_ > 0 && !is_stalled_) mean_us_ = (7 * mean_us_ + interval_us) / 8;
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
  }
  [[nodiscard]] uint64_t silence_us(uint64_t now_us) const { return now_us - since_us_; }
  [[nodiscard]] uint64_t limit_us() const {
    return n_frames_ == 0 ? kFirstUs : std::max(3 * std::max(period_us_, mean_us_), kMinUs);
  }

 private:
  uint64_t period_us_;
  uint64_t mean_us_;
  uint64_t n_frames_ = 0;
  uint64_t since_us_ = 0;
  bool is_stalled_ = false;
};

}  // namespace ruffini
