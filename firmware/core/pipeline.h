// Runs the board's stages in the order of the table and times each (Frame::stage_ns).
//
// The table determines legal combinations: a stage runs if its tables are loaded and an earlier stage writes each slot
// that it must read. With [pipeline] cores = 2 the stages are in segments (core/stages.h), each of which can hold
// another frame: a segment is used by one frame thread at a time, enter() by the one that holds the segment before it,
// too. All other functions need all segments. No allocation after load().
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
  // `rest` and `state`, which is the last segment's, must outlive this object.
  Pipeline(const BoardSettings& board, Rest& rest, FrameState& state, ClockFunction clock);

  // Call once before the first frame. `calibration` may be null. `written`: slots that are written from outside the
  // pipeline.
  [[nodiscard]] Status load(const Calibration* calibration, SlotSet written = {});
  // True if a stage of this board writes the slot.
  [[nodiscard]] bool writes(Slot slot) const { return written_.has(slot); }

  void learn(std::span<const uint16_t> rest);
  [[nodiscard]] size_t n_segments() const { return segments_.size(); }
  [[nodiscard]] const FrameState& first_state() const { return *segments_.front().state; }
  // A frame enters the segment; if it is measured, its slots come with it.
  void enter(size_t segment, const Frame& frame);
  void run(size_t segment, Frame& frame);
  // Runs only the stages that depend on this slot, directly or through other slots.
  void run_from(Slot slot, Frame& frame);
  // Computes a slot whose writer computes it on request only.
  void compute(Slot slot, Frame& frame);
  void judge(uint32_t& flags);
  void forget();
  // Adds time to the stage that writes this slot.
  void charge(Slot slot, uint64_t ns, Frame& frame) const;

 private:
  struct Entry {
    const StageEntry* declared = nullptr;
    size_t timed_as = 0;  // row of the table
    size_t segment = 0;
    std::unique_ptr<Stage> stage{};
    bool is_active = false;
  };
  struct Segment {
    FrameState* state;
    SlotSet received{};  // from the segments before
  };
  void run(const Entry& entry, Frame& frame);
  void make_segments(const BoardSettings& board, FrameState& state);
  // Calls each(entry) for all stages; before those of a segment, pass(slots, from, to) takes its slots from the segment
  // before.
  template <typename Pass, typename Each>
  void for_each_stage(Pass pass, Each each);

  std::vector<std::unique_ptr<FrameState>> own_states_;
  std::vector<Segment> segments_;
  ClockFunction clock_;
  std::vector<Entry> stages_;
  SlotSet written_;
};

}  // namespace ruffini
