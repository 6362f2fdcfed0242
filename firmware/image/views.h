// Several views of the pad in one frame, side by side and equally wide: two cameras, or a camera and its mirror image.
//
// Kind `views` of proto/CALIBRATION.md holds one ray table for each view (image/ray_table.h), which includes any
// mirror. A point seen in two views is where their rays are closest to each other at one height:
//
//   z = (S_2 - S_1) . (A_1 - A_2) / |S_2 - S_1|^2,   x, y = mean of A_i + S_i z
//
// Frame thread; no allocation after load().
#pragma once

#include <cstdint>
#include <vector>

#include "base/result.h"
#include "board/settings.h"
#include "image/ray_table.h"
#include "store/calibration.h"

namespace ruffini {

// Intersection of two rays: micrometres Q8, pad frame.
struct RayIntersection {
  bool is_found = false;  // false: the rays are nearly parallel, or the point is beyond 1 m
  int64_t x_q8 = 0;
  int64_t y_q8 = 0;
  int64_t z_q8 = 0;
  int64_t gap_q8 = 0;  // distance of the rays at that height, the larger of x and y
};

class ViewMaps {
 public:
  static constexpr int64_t kMaxViews = 4;
  static constexpr int64_t kMaxHeightQ8 = int64_t{1} << 28;  // 1 m

  // Errors: kBadInput.
  [[nodiscard]] static Result<ViewMaps> load(const Calibration& calibration, const BoardSettings& board);

  [[nodiscard]] size_t count() const { return views_.size(); }
  // Returns the ray through a position of the frame in pixels, in one view. Precondition: view < count().
  [[nodiscard]] PadRay at(size_t view, int64_t px_x_q16, int64_t px_y_q16) const;

 private:
  int width_px_ = 0;  // of a view
  std::vector<RayTable> views_;
};

[[nodiscard]] RayIntersection triangulate(const PadRay& first, const PadRay& second);

}  // namespace ruffini
