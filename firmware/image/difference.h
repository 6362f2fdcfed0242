// Relative change of each pixel against rest; flat field and difference in one step.
//
//   d = ((16 I - rest) reciprocal + 2^19) >> 20         Q12: 4096 = +100 %
//
// rest in 1/16 grey levels, reciprocal = 2^32 / max(rest, 512): exactly zero at rest, and |d| < 8. Also counts dark and full pixels, which the flags need.
#pragma once

#include <cstdint>
#include <span>

#include "base/fixed.h"
#include "base/image_view.h"

namespace ruffini {

struct ExposureCounts {
  int dark = 0;  // all channels below kDarkLevel
  int full = 0;  // any channel at 255
};

inline constexpr int kDarkLevel = 8;

// `rest`, `reciprocal`, `out`: width x height x 3.
ExposureCounts difference(const FrameView& frame, std::span<const uint16_t> rest, std::span<const uint32_t> reciprocal,
                          std::span<RelativeChange> out);

}  // namespace ruffini
