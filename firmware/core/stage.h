// One stage of the data path. A stage takes its slots when it is made (core/slots.h), and its tables in load(); after that
// it allocates nothing. Frame thread.
#pragma once

#include <cstdint>
#include <span>

#include "base/fixed.h"
#include "base/image_view.h"
#include "base/result.h"
#include "board/settings.h"
#include "core/slots.h"
#include "image/rest.h"
#include "store/calibration.h"

namespace ruffini {

// The frame that is on its way through the stages.
struct Frame {
  FrameView view;
  uint64_t capture_us = 0;  // 0: not known
  Warmth warmth;
  uint32_t& flags;  // of this frame so far; a stage adds its own
  SaturationCounter& saturations;

  bool was_touched = false;            // by the frame before something pressed
  bool is_zero_followed = false;       // of a live camera, on a pad whose forces are measured
  bool is_displacement_given = false;  // by a caller, with its depth; not by a camera

  [[nodiscard]] bool is_wrong() const { return (flags & kWrongFlags) != 0; }
};

class Stage {
 public:
  Stage() = default;
  Stage(const Stage&) = delete;
  Stage& operator=(const Stage&) = delete;
  Stage(Stage&&) = delete;
  Stage& operator=(Stage&&) = delete;
  virtual ~Stage() = default;

  // Its tables, called once if the calibration has one of the kinds that the stage is declared with. Errors: kBadInput,
  // kRefused.
  [[nodiscard]] virtual Status load(const Calibration& /*calibration*/) { return Unit{}; }
  // After load(): whether run() writes this slot. A stage that writes none is not run.
  [[nodiscard]] virtual bool writes(Slot /*slot*/) const { return true; }
  // A new rest is in force; its image, width x height x 3 in 1/16 grey levels. Slots that it reads have learned it.
  virtual void learn(std::span<const uint16_t> /*rest*/) {}
  // A frame begins, which may be one that is not run: what is stated of a single frame no longer holds.
  virtual void begin() {}
  virtual void run(Frame& frame) = 0;
  // After run(), for a slot that is computed only if somebody asks for it.
  virtual void compute(Slot /*slot*/, const Frame& /*frame*/) {}
  // All flags of the frame that make results invalid are known: validity of what this stage writes. May change the
  // flags that do not (kFlagUncalibratedXy, kFlagUncalibratedZ, kFlagWindowBorder).
  virtual void judge(uint32_t& /*flags*/) {}
  // What was done to the pad before the next frame.
  virtual void forget() {}
};

// What a stage is made of.
struct StageContext {
  const BoardSettings& board;
  SlotAccess& slots;
  SlotSet written;  // by any stage of the board, if it has its tables
  Rest& rest;       // learned by the frame path before a stage runs; only the stage of the light sets its gain
};

}  // namespace ruffini
