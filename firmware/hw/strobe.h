// Switches the lamps between camera frames, so that every second frame is dark, and records when.
//
//   exposure of frame k+1 begins at m + T - e/2     m: exposure midpoint of frame k, T: period, e: exposure time
//   guard = (T - e) / 8; the lamps are switched one guard earlier, after all rows of frame k were read
//
// A frame counts as lit or dark if the lamps were constant from the start of its exposure until two guards before that
// of the next frame. So exposure and read-out together must leave two guards of the period: a quarter of the unexposed
// time.
#pragma once

#include <array>
#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <optional>
#include <thread>

#include "hw/output_line.h"

namespace ruffini {

// Computes when to switch, and records the lamps' states. Times are microseconds of one clock.
class StrobePlan {
 public:
  StrobePlan(uint64_t period_us, uint64_t exposure_us);

  // Records a frame; its exposure midpoint synchronizes the following switches.
  void record_frame(uint64_t middle_us) { middle_us_ = middle_us; }
  // Next switching time after `now_us`; no value before the first frame.
  [[nodiscard]] std::optional<uint64_t> next_us(uint64_t now_us) const;
  void switched(uint64_t at_us, bool is_on);
  [[nodiscard]] uint64_t period_us() const { return period_us_; }
  // State of the lamps during the frame with this exposure midpoint; no value if they were switched meanwhile, or it is
  // too long ago.
  [[nodiscard]] std::optional<bool> lamps_during(uint64_t middle_us) const;

 private:
  struct Switch {
    uint64_t at_us = 0;
    bool is_on = false;
  };
  uint64_t period_us_;
  uint64_t exposure_us_;
  uint64_t guard_us_;
  uint64_t middle_us_ = 0;
  std::array<Switch, 16> switches_{};  // ring of the last switches
  size_t n_switches_ = 0;
};

class Strobe {
 public:
  // `line` must outlive this object. Switching begins with the first recorded frame.
  Strobe(OutputLine& line, uint64_t period_us, uint64_t exposure_us);
  ~Strobe();
  Strobe(const Strobe&) = delete;
  Strobe& operator=(const Strobe&) = delete;

  // Capture thread, for each frame: records it and returns StrobePlan::lamps_during().
  [[nodiscard]] std::optional<bool> record_frame(uint64_t middle_us);

 private:
  void loop();

  OutputLine& line_;
  std::mutex mutex_;  // guards the members below
  std::condition_variable changed_;
  StrobePlan plan_;
  bool is_ending_ = false;
  std::thread thread_;
};

}  // namespace ruffini
