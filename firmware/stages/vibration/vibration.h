// Measures vibration of a contact (a motor, a rough sliding surface, a struck object) as the picture change between
// consecutive frames.
//
//   d        = grey of a pixel minus that of the previous frame, one pixel of each kStepPx x kStepPx
//   variance = mean(d^2) - mean(d)^2                a change common to all pixels comes from the lamps
//   level    = 10 log10(variance / (1 grey level)^2)      in hundredths of a decibel
//
// 0 dB is an rms change of one grey level. Levels depend on the camera: compare them on one sensor, and with the level
// at rest, which is the camera's noise; they do not convert to force. Frequencies above half the frame rate are aliased
// and still counted. Not in the papers. Frame thread; no allocation after the constructor. Reads 1/16 of the pixels.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

class Vibration {
 public:
  static constexpr int kStepPx = 4;

  Vibration(int width_px, int height_px);

  // `grey`: as in image/difference.h; compared with the previous call (black at first). Returns hundredths of a
  // decibel.
  int32_t run(std::span<const uint16_t> grey);

 private:
  GridSize size_px_;
  std::vector<uint16_t> before_;
};

}  // namespace ruffini
