// Runs the board's stages in the order of the table and times each (FrameState::stage_ns).
//
// The table determines legal combinations: a stage runs if its tables are loaded and an earlier stage writes each slot
// that it must read. Frame thread; no allocation after load().
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "base/result.h"
#include "board/settings.h"
#include "core/slots.h"
#include "core/stages.h"
#include "store/calibration.h"

namespace ruffini {

// Monotonic nanoseconds, as a parameter because the core makes no system call.
using ClockFunction = uint64_t (*)();

class Pipeline {
 public:
  // `rest` and `state` must outlive this object.
  Pipeline(const BoardSettings& board, Rest& rest, FrameState& state, ClockFunction clock);

  // Call once before the first frame. `calibration` may be null. `written`: slots that are written from outside the
  // pipeline.
  [[nodiscard]] Status load(const Calibration* calibration, SlotSet written = {});
  // True if a stage of this board writes the slot.
  [[nodiscard]] bool writes(Slot slot) const { return written_.has(slot); }

  void learn(std::span<const uint16_t> rest);
  void begin();
  void run(Frame& frame);
  // Runs only the stages that depend on this slot, directly or through other slots.
  void run_from(Slot slot, Frame& frame);
  // Computes a slot whose writer computes it on request only.
  void compute(Slot slot, Frame& frame);
  void judge(uint32_t& flags);
  void forget();
  // Adds time to the stage that writes this slot.
  void charge(Slot slot, uint64_t ns);

 private:
  struct Entry {
    const StageEntry* declared = nullptr;
    size_t timed_as = 0;  // row of the table
    std::unique_ptr<Stage> stage{};
    bool is_active = false;
  };
  void run(const Entry& entry, Frame& frame);

  FrameState& state_;
  ClockFunction clock_;
  std::vector<Entry> stages_;
  SlotSet written_;
};

}  // namespace ruffini
