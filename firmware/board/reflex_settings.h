// [reflex] of board.toml: an output line that switches on a limit (frame_reflex.h).
#pragma once

#include <cstdint>
#include <string>

namespace ruffini {

enum class ReflexSlip { kNone, kIncipient, kSlides };
enum class WhenInvalid { kHold, kOn, kOff };

// An empty line: none.
struct ReflexSettings {
  std::string chip;
  std::string line;
  int64_t force_un = 0;  // 0: no limit
  ReflexSlip slip = ReflexSlip::kNone;
  WhenInvalid when_invalid = WhenInvalid::kHold;
};

}  // namespace ruffini
