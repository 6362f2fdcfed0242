// Detects motion of the camera against a fingertip whose wall is clamped at its rim, from the outermost pins of a view.
//
//   rim      the fifth of a view's pins that are farthest from the centre at rest, in four sectors: right, left, below,
//            above; a sector with less than half of its pins visible counts as 0
//   d        mean displacement of a sector, px; n, t: outward normal and tangent
//   shift    d_x and d_y of the four sectors       zoom   d . n       turn   d . t
// Each quantity is what at least three of the four sectors agree on (estimators/common_part.h). With load = force /
// max_un, the largest force of the calibration, the camera counts as moved if
//   |shift| > kShift + at_max.shift load        |zoom| or |turn| > kZoom + at_max.zoom load
// at_max is what the presses of the fit do to the rim (`fingertip.rim`), and at least the default: a stiff wall moves
// it by 2.1 px at 13 N, a soft one by 0.5 px at 1.3 N.
//
// On the twin, presses of 0.2 to 1.2 N by three tools of 2.5 to 8 mm, up to 6.5 mm off the top and tilted by up to 44
// degrees, shift the rim of the thin wall by at most 0.6 px/N and zoom it by 0.34 px/N, at max_un = 1.3 N; noise is
// 0.004 px. A shift of 0.4 px would indicate 0.14 N on an untouched fingertip, and a zoom of 0.2 % (0.23 px at the rim)
// would hide 0.4 N.
// Limit: the same motion under a load. Frame thread; no allocation after the constructor but in learn(). Not in the
// paper.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "image/markers.h"

namespace ruffini {

class RimMotion {
 public:
  // Motion shared by three sectors, without sign: px Q16.
  struct Motion {
    int64_t shift_x_q16 = 0;
    int64_t shift_y_q16 = 0;
    int64_t zoom_q16 = 0;
    int64_t turn_q16 = 0;
  };

  // Motion of the rim by a load of max_un, px Q16.
  struct AtMax {
    int64_t shift_q16 = 78'643;  // 1.2 px
    int64_t zoom_q16 = 39'322;   // 0.6 px
  };

  explicit RimMotion(AtMax at_max) : at_max_(at_max) {}
  RimMotion() = default;

  // Learns the markers of one view at rest.
  void learn(std::span<const Marker> markers);
  [[nodiscard]] Motion motion(std::span<const Marker> markers) const;
  // Precondition: max_un > 0. Larger forces count as max_un.
  [[nodiscard]] bool has_moved(std::span<const Marker> markers, int64_t force_un, int64_t max_un) const;

 private:
  static constexpr size_t kSectors = 4;

  AtMax at_max_;
  std::array<std::vector<size_t>, kSectors> rim_;  // indices of markers: right, left, below, above
};

}  // namespace ruffini
