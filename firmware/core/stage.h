// Interface of one stage of the data path. A stage takes its slots at construction (core/slots.h) and its tables in
// load(); after that it allocates nothing. Frame thread.
#pragma once

#include <array>
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

// The frame being processed.
struct Frame {
  FrameView view{};
  uint64_t capture_us = 0;  // 0: unknown
  Warmth warmth{};
  uint32_t flags = 0;               // so far; a stage adds its own
  SaturationCounter saturations{};  // of this frame
  std::array<uint64_t, kMaxRows> stage_ns{};
  std::array<uint64_t, kMaxSegments> segment_ns{};  // not of a single one
  size_t segment = 0;                               // that holds it

  bool is_measured = true;
  bool is_alone = false;               // rest may change at its end: the next frame must not begin before that
  bool is_zero_followed = false;       // for a live camera on a pad whose forces are measured
  bool is_displacement_given = false;  // given by a caller, with its depth, instead of a camera

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

  // Loads the tables. Called once if the calibration has one of the kinds declared for the stage. Errors: kBadInput,
  // kRefused.
  [[nodiscard]] virtual Status load(const Calibration& /*calibration*/) { return Unit{}; }
  // After load(): true if run() writes or amends this slot. A stage that changes no slot is not run.
  [[nodiscard]] virtual bool writes(Slot /*slot*/) const { return true; }
  // A new rest image is in force: width x height x 3 in 1/16 grey levels. The slots that this stage reads have learned
  // it already.
  virtual void learn(std::span<const uint16_t> /*rest*/) {}
  // A frame begins, which may not be run: resets everything that applies to a single frame.
  virtual void begin() {}
  virtual void run(Frame& frame) = 0;
  // Called after run() on request, for a slot that is not computed in every frame.
  virtual void compute(Slot /*slot*/, const Frame& /*frame*/) {}
  // Sets the validity of the results in the frame's last segment (core/stages.h): a stage of an earlier one may not
  // override it. All flags that make results invalid are known. May change the other flags
  // (kFlagUncalibratedXy, kFlagUncalibratedZ, kFlagWindowBorder).
  virtual void judge(uint32_t& /*flags*/) {}
  // Resets the history of the pad.
  virtual void forget() {}
};

// Constructor arguments of a stage.
struct StageContext {
  const BoardSettings& board;
  SlotAccess& slots;
  SlotSet written;         // by any stage of the board that has its tables
  bool has_lamp_features;  // one of the board's stages writes features that vary by lamp
  Rest& rest;              // learned by the frame path before a stage runs; only the light stage sets its gain
};

}  // namespace ruffini
