// Maps every pixel to the ray that meets the pad: lens, mounting, refraction and mirror in one table computed by the
// host.
//
//   a surface point at height z that is seen at pixel p is at   X = A(p) + S(p) z
//
// Inside a clear gel with a flat back the ray is straight, so the map is exact for pinhole and fisheye lenses, tilted
// cameras and plane mirrors alike (image/ray_table.h).
//
// Depth is computed in the view of an ideal pinhole above the pad's centre, with the board's scale and principal point
// (refraction scales focal length and distance together); image/slope_rectifier.h converts the slopes to that view.
// Frame thread; no allocation after load().
#pragma once

#include <cstdint>

#include "base/result.h"
#include "board/settings.h"
#include "image/ray_table.h"
#include "store/calibration.h"

namespace ruffini {

// Returns the board with the ideal pinhole of kind `camera` as its camera. Errors: kBadInput.
[[nodiscard]] Result<BoardSettings> pinhole_board(const Calibration& calibration, const BoardSettings& board);

class CameraMap {
 public:
  // Kind `camera` of proto/CALIBRATION.md. Errors: kBadInput.
  [[nodiscard]] static Result<CameraMap> load(const Calibration& calibration, const BoardSettings& board);

  // Returns the ray through an image position in pixels; outside the image, that of the border.
  [[nodiscard]] PadRay at(int64_t px_x_q16, int64_t px_y_q16) const { return rays_.at(px_x_q16, px_y_q16); }

  // The board with the ideal pinhole as its camera: the geometry that depth and nodes use.
  [[nodiscard]] const BoardSettings& ideal_board() const { return ideal_; }

 private:
  BoardSettings ideal_;
  RayTable rays_;
};

}  // namespace ruffini
