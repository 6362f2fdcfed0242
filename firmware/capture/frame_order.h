// The order of a live camera's frames: numbers and times that only go forward, and what was wrong with them.
//
//   number  not above the one before: the frame is not used (a repeat, or late). Three in a row that count up among
//           themselves: the camera was started again, and goes on from the number after the last
//   time    not above the one before, 0, or ahead of now by more than 20 ms: the time of arrival stands for it
//   old     more than a second before now: not used, up to kMostOld frames in a row (what a camera holds back while the
//           device stood still); beyond that its clock is wrong, and the time of arrival stands for it
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
  static constexpr int kMostOld = 16;
  static constexpr int kRestart = 3;

  struct Verdict {
    bool is_used = true;
    uint64_t n_missed = 0;  // numbers before it that never came
    bool is_time_wrong = false;
  };

  // Puts `number` and `capture_us` right. `now_us` 0: times are the recording's own, and go forward, no more.
  [[nodiscard]] Verdict check(uint64_t& number, uint64_t& capture_us, uint64_t now_us) {
    if (has_last_ && number <= last_number_) {
      n_back_ = number > back_ ? n_back_ + 1 : 1;
      back_ = number;
      if (n_back_ < kRestart) return {.is_used = false};
      shift_ += last_number_ + 1 - number;
      last_number_ = number - 1;
    }
    const bool is_old = now_us != 0 && capture_us != 0 && capture_us < now_us && now_us - capture_us > kOldUs;
    n_old_ = is_old ? n_old_ + 1 : 0;
    if (is_old && n_old_ <= kMostOld) return {.is_used = false};
    Verdict verdict{.is_used = true, .n_missed = has_last_ ? number - last_number_ - 1 : 0};
    const bool goes_back = has_last_ && capture_us <= last_us_;
    const bool is_ahead = now_us != 0 && (capture_us == 0 || capture_us > now_us + kAheadUs);
    verdict.is_time_wrong = is_old || goes_back || is_ahead;
    if (verdict.is_time_wrong) capture_us = std::max(now_us, last_us_ + 1);
    last_us_ = capture_us;
    last_number_ = number;
    back_ = 0;
    n_back_ = 0;
    has_last_ = true;
    number += shift_;
    return verdict;
  }

 private:
  bool has_last_ = false;
  uint64_t last_number_ = 0;  // the camera's own
  uint64_t last_us_ = 0;
  uint64_t back_ = 0;  // last number that was not above it
  int n_back_ = 0;
  int n_old_ = 0;
  uint64_t shift_ = 0;
};

}  // namespace ruffini
