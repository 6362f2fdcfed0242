// Relative change of each pixel against rest; flat field and difference in one step.
//
//   d = (I reciprocal + 2^15) >> 16, minus 4096         Q12: 4096 = +100 %
//
// since reciprocal = 2^32 / (16 I_rest). Also counts dark and full pixels, which the flags need.
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

// `out`: width x height x 3. Saturation counted.
ExposureCounts difference(const FrameView& frame, std::span<const uint32_t> reciprocal,
                          std::span<RelativeChange> out, SaturationCounter& saturations);

}  // namespace ruffini
