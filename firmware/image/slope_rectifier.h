// Resamples the slopes of the depth cells from the image to the ideal pinhole of image/camera_map.h: bilinearly between
// depth cells; outside the image the border is used. Frame thread; no allocation after load().
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/result.h"
#include "board/settings.h"
#include "image/photometric.h"
#include "store/calibration.h"

namespace ruffini {

class SlopeRectifier {
 public:
  // Kind `camera` of proto/CALIBRATION.md. Errors: kBadInput.
  [[nodiscard]] static Result<SlopeRectifier> load(const Calibration& calibration, const BoardSettings& board);

  void run(std::span<CellSlope> slope);

 private:
  struct Source {
    uint32_t cell = 0;  // upper left of four cells
    uint16_t right_q8 = 0;
    uint16_t below_q8 = 0;
  };

  GridSize cells_;
  std::vector<Source> sources_;  // of each depth cell
  std::vector<CellSlope> seen_;  // the image's slopes during resampling
};

}  // namespace ruffini
