// Decides whether a force or slip limit is exceeded, for an output line that a gripper's controller reads within one
// frame ([reflex] of board.toml).
//
//   on:  |F| > force_un (0: no limit), or a contact has reached the slip state (kFree: no limit)
//   off: |F| <= 7/8 force_un and no contact in that state
//   |F|: over the components that are valid in this frame. If none is valid: `when_invalid`
//
// Frame thread; no allocation, integers.
#pragma once

#include <cstdint>

#include "board/settings.h"
#include "core/slots.h"

namespace ruffini {

class Reflex {
 public:
  explicit Reflex(const ReflexSettings& settings) : settings_(settings) {}

  [[nodiscard]] bool update(const FrameState& state);
  [[nodiscard]] bool is_on() const { return is_on_; }

 private:
  [[nodiscard]] bool slips(const FrameState& state) const;

  ReflexSettings settings_;
  bool is_on_ = false;
};

}  // namespace ruffini
