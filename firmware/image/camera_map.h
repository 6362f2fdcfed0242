// Where every pixel's ray meets the pad: lens, mounting, refraction and mirror in one table that the host computes.
//
//   a point of the deformed surface at height z that is seen at pixel p lies at   X = A(p) + S(p) z
//
// Through a clear gel with a flat back the ray inside it is straight, so this is exact for pinhole, fisheye, a camera
// mounted askew and a plane mirror alike (image/ray_table.h).
//
// Depth is computed in the view of an ideal pinhole above the pad's centre, of the board's scale and principal point
// (focal length and distance grow together with the refraction); image/slope_rectifier.h brings the slopes there.
// Frame thread; no allocation after load().
#pragma once

#include <cstdint>

#include "base/result.h"
#include "board/settings.h"
#include "image/ray_table.h"
#include "store/calibration.h"

namespace ruffini {

// The board with the ideal pinhole of kind `camera` as its camera. Errors: kBadInput.
[[nodiscard]] Result<BoardSettings> pinhole_board(const Calibration& calibration, const BoardSettings& board);

class CameraMap {
 public:
  // Kind `camera` of proto/CALIBRATION.md. Errors: kBadInput.
  [[nodiscard]] static Result<CameraMap> load(const Calibration& calibration, const BoardSettings& board);

  // The ray through an image place, pixels; the border's beyond the image.
  [[nodiscard]] PadRay at(int64_t px_x_q16, int64_t px_y_q16) const { return rays_.at(px_x_q16, px_y_q16); }

  // The board with the ideal pinhole as its camera: what depth and nodes are computed with.
  [[nodiscard]] const BoardSettings& ideal_board() const { return ideal_; }

 private:
  BoardSettings ideal_;
  RayTable rays_;
};

}  // namespace ruffini
