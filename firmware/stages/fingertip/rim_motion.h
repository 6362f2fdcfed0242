// Detects motion of the camera against a fingertip whose wall is clamped at its rim: by the outermost pins of a view.
//
//   rim      the fifth of a view's pins that rest farthest from the middle of all, in four sectors: right, left, below,
//            above; a sector of which less than half is seen says 0
//   d        mean displacement of a sector, px; n, t: outward normal and tangent
//   shift    d_x and d_y of the four sectors       zoom   d . n       turn   d . t
// Each is what three of four sectors have in common (estimators/common_part.h). With load = force / most_un, of what the
// calibration was fitted up to, the camera counts as moved if
//   |shift| > kShift + kShiftAtMost load        |zoom| or |turn| > kZoom + kZoomAtMost load
//
// On the twin 0.2 to 1.2 N, by three tools of 2.5 to 8 mm up to 6.5 mm off the top, turned by up to 44 degrees, shift the
// rim by at most 0.6 px/N and zoom it by 0.34 px/N, at most_un = 1.3 N; noise is 0.004 px. A shift by 0.4 px makes 0.14 N
// of an untouched fingertip, and a zoom by 0.2 % (0.23 px at the rim) hides 0.4 N. Limit: the same motion under a load.
// Frame thread; no allocation after the constructor but in learn(). Not in the paper.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "image/markers.h"

namespace ruffini {

class RimMotion {
 public:
  // What three sectors have in common, without sign: px Q16.
  struct Motion {
    int64_t shift_x_q16 = 0;
    int64_t shift_y_q16 = 0;
    int64_t zoom_q16 = 0;
    int64_t turn_q16 = 0;
  };

  // Markers of one view at rest.
  void learn(std::span<const Marker> markers);
  [[nodiscard]] Motion motion(std::span<const Marker> markers) const;
  // `most_un`: more than 0. Forces beyond it count as that.
  [[nodiscard]] bool has_moved(std::span<const Marker> markers, int64_t force_un, int64_t most_un) const;

 private:
  static constexpr size_t kSectors = 4;

  std::array<std::vector<size_t>, kSectors> rim_;  // numbers of markers: right, left, below, above
};

}  // namespace ruffini
