// How much the picture of a touched pad moves from one frame to the next: vibration of the contact, as by a motor, a rough
// surface that slides, or an object that is struck.
//
//   d        = grey of a pixel less that of the frame before, one pixel of each kStepPx x kStepPx
//   variance = mean(d^2) - mean(d)^2                what all pixels have in common is the lamps', not the contact's
//   level    = 10 log10(variance / (1 grey level)^2)      in hundredths of a decibel
//
// 0 dB is a picture that changes by one grey level, rms. The unit is the camera's: levels are compared with each other on
// one sensor, and with the level at rest, which is the noise of its camera; no force follows from them. Frames see what is
// below half of their rate; what is faster is aliased, and counts all the same. Not in the papers.
// Frame thread; no allocation after the constructor. 1/16 of the pixels are read.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

// log2 of x in 1/65536, rounded down. Precondition: x > 0.
[[nodiscard]] int64_t log2_q16(uint64_t x);

class Vibration {
 public:
  static constexpr int kStepPx = 4;

  Vibration(int width_px, int height_px);

  // `grey` as of image/difference.h, against that of the call before (black at first). Hundredths of a decibel.
  int32_t run(std::span<const uint16_t> grey);

 private:
  GridSize size_px_;
  std::vector<uint16_t> before_;
};

}  // namespace ruffini
