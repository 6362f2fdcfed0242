// Enforces increasing frame numbers and times for a live camera, and reports violations.
//
//   number  not above the previous one: the frame is skipped (a repeat, or late). Three such frames in a row that
//           increase among themselves: the camera was restarted, and counting continues from the last number
//   time    not above the previous one, 0, or more than 20 ms ahead of now: replaced by the time of arrival
//   old     more than a second before now: skipped, up to kMaxOld frames in a row (frames buffered while the device
//           was suspended); beyond that the camera's clock is wrong, and the time of arrival is used
//
// Capture thread.
#pragma once

#include <algorithm>
#include <cstdint>

namespace ruffini {

class FrameOrder {
 public:
  static constexpr uint64_t kAheadUs = 20'000;
  static constexpr uint64_t kOldUs = 1'000'000;
  static constexpr int kMaxOld = 16;
  static constexpr int kRestart = 3;

  struct Outcome {
    bool is_used = true;
    uint64_t n_missed = 0;  // preceding numbers that never arrived
    bool is_time_wrong = false;
  };

  // Corrects `number` and `capture_us`. `now_us` 0: times are those of a recording, and only need to increase.
  [[nodiscard]] Outcome check(uint64_t& number, uint64_t& capture_us, uint64_t now_us) {
    if (has_last_ && number <= last_number_) {
      n_back_ = number > back_ ? n_back_ + 1 : 1;
      back_ = number;
      if (n_back_ < kRestart) return {.is_used = false};
      shift_ += last_number_ + 1 - number;
      last_number_ = number - 1;
    }
    const bool is_old = now_us != 0 && capture_us != 0 && capture_us < now_us && now_us - capture_us > kOldUs;
    n_old_ = is_old ? n_old_ + 1 : 0;
    if (is_old && n_old_ <= kMaxOld) return {.is_used = false};
    Outcome outcome{.is_used = true, .n_missed = has_last_ ? number - last_number_ - 1 : 0};
    const bool goes_back = has_last_ && capture_us <= last_us_;
    const bool is_ahead = now_us != 0 && (capture_us == 0 || capture_us > now_us + kAheadUs);
    outcome.is_time_wrong = is_old || goes_back || is_ahead;
    if (outcome.is_time_wrong) capture_us = std::max(now_us, last_us_ + 1);
    last_us_ = capture_us;
    last_number_ = number;
    back_ = 0;
    n_back_ = 0;
    has_last_ = true;
    number += shift_;
    return outcome;
  }

 private:
  bool has_last_ = false;
  uint64_t last_number_ = 0;  // the camera's own number
  uint64_t last_us_ = 0;
  uint64_t back_ = 0;  // last number that was not above the previous one
  int n_back_ = 0;
  int n_old_ = 0;
  uint64_t shift_ = 0;
};

}  // namespace ruffini
