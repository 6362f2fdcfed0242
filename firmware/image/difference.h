// Relative change of each pixel from the rest image, and grey: flat field and difference in one step.
//
//   d = ((16 I - rest) 8 reciprocal + 2^14) >> 15         Q12: 4096 = +100 %
//   grey = 12 (B + 2 G + R)                               1/16 levels of three channels, 0..12240
//
// The weights are nearly those of luma: cameras that send compressed or raw frames resolve green best and blue and red
// worst. rest in 1/16 grey levels, reciprocal = 2^24 / max(rest, 512) (rest.h): the result is exactly zero at rest, and
// |d| < 8. Everything fits 16 bits. Also counts dark and saturated pixels for the flags. Frame thread; no allocation.
#pragma once

#include <cstdint>
#include <span>

#include "base/fixed.h"
#include "base/image_view.h"
#include "image/rest.h"

namespace ruffini {

struct ExposureCounts {
  int dark = 0;  // all channels below kDarkLevel
  int full = 0;  // any channel at 255
};

inline constexpr int kDarkLevel = 8;

// One row of pixels, and planes of B, G and R that are `plane` values apart.
struct DifferenceRow {
  const uint8_t* pixels = nullptr;  // B, G, R interleaved
  int width = 0;
  const int16_t* rest8 = nullptr;  // 8 times the rest image
  const int16_t* reciprocal = nullptr;
  ptrdiff_t plane = 0;
  int16_t* change = nullptr;
  uint16_t* grey = nullptr;
};
using DifferenceRun = ExposureCounts (*)(const DifferenceRow& row);

// The reference. Other versions call it for the remaining pixels of a row, from `first` on.
ExposureCounts difference_row_scalar(const DifferenceRow& row, int first);

// `change`: planes of B, G and R, width x height each; `grey`: width x height.
ExposureCounts difference(DifferenceRun run, const FrameView& frame, const Rest& rest, std::span<RelativeChange> change,
                          std::span<uint16_t> grey);
ExposureCounts difference(const FrameView& frame, const Rest& rest, std::span<RelativeChange> change,
                          std::span<uint16_t> grey);

}  // namespace ruffini
