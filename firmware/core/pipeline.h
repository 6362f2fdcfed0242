// The board's stages in the order of the table, each timed (FrameState::stage_ns).
//
// Legal combinations follow from the table: a stage is run if its tables are loaded and a stage before it writes each slot
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

// Monotonic nanoseconds; the core itself makes no system call.
using ClockFunction = uint64_t (*)();

class Pipeline {
 public:
  // `rest` and `state` outlive this.
  Pipeline(const BoardSettings& board, Rest& rest, FrameState& state, ClockFunction clock);

  // Once, before the first frame. `calibration` may be null. `written`: slots that others than these stages write.
  [[nodiscard]] Status load(const Calibration* calibration, SlotSet written = {});
  // Some stage writes this slot.
  [[nodiscard]] bool writes(Slot slot) const { return written_.has(slot); }

  void learn(std::span<const uint16_t> rest);
  void begin();
  void run(Frame& frame);
  // Only what depends on this slot, directly or through other slots.
  void run_from(Slot slot, Frame& frame);
  // A slot that its writer computes only if it is asked for.
  void compute(Slot slot, Frame& frame);
  void judge(uint32_t& flags);
  void forget();
  // Time that was spent for the writer of this slot.
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
