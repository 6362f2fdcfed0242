// Switches the lamps between the frames of a camera, every second one dark, and remembers when it did.
//
//   frame k+1 begins to be exposed at m + T - e/2     m: middle of exposure of frame k, T: its period, e: its exposure
//   guard = (T - e) / 8; the lamps are switched one guard before that, when all rows of frame k have been read
//
// A frame is lit, or dark, where the lamps were so, unswitched, from the begin of its exposure to two guards before that of
// the next one. So exposure and read-out together must leave two guards of the frame's time: a quarter of what is not exposed.
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

// When to switch, and what the lamps did. Times in microseconds of one clock.
class StrobePlan {
 public:
  StrobePlan(uint64_t period_us, uint64_t exposure_us);

  // The camera took a frame: its middle of exposure sets the pace from here on.
  void saw(uint64_t middle_us) { middle_us_ = middle_us; }
  // The next time to switch after `now_us`; nothing before the first frame.
  [[nodiscard]] std::optional<uint64_t> next_us(uint64_t now_us) const;
  void switched(uint64_t at_us, bool is_on);
  [[nodiscard]] uint64_t period_us() const { return period_us_; }
  // Lamps during the frame of this middle of exposure: on, off; nothing where they were switched, or it is too long ago.
  [[nodiscard]] std::optional<bool> during(uint64_t middle_us) const;

 private:
  struct Switch {
    uint64_t at_us = 0;
    bool is_on = false;
  };
  uint64_t period_us_;
  uint64_t exposure_us_;
  uint64_t guard_us_;
  uint64_t middle_us_ = 0;
  std::array<Switch, 16> switches_{};  // the last ones, in turn
  size_t n_switches_ = 0;
};

class Strobe {
 public:
  // `line` outlives it. Begins with the first frame that it is told of.
  Strobe(OutputLine& line, uint64_t period_us, uint64_t exposure_us);
  ~Strobe();
  Strobe(const Strobe&) = delete;
  Strobe& operator=(const Strobe&) = delete;

  // Capture thread, of each frame: as StrobePlan::during; and the pace from here on.
  [[nodiscard]] std::optional<bool> saw(uint64_t middle_us);

 private:
  void loop();

  OutputLine& line_;
  std::mutex mutex_;  // of what follows
  std::condition_variable changed_;
  StrobePlan plan_;
  bool is_ending_ = false;
  std::thread thread_;
};

}  // namespace ruffini
