// Rays on a lattice of image positions, interpolated bilinearly.
//
//   a point at height z that is seen at pixel p is at   X = A(p) + S(p) z
//
// A (Q8 um, relative to the pad's centre) and S (Q20) are stored on lattice lines 2^k pixels apart; positions outside
// the image use the border. Frame thread; no allocation after load().
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "base/image_view.h"
#include "base/result.h"

namespace ruffini {

// A ray of the camera in the pad's frame.
struct PadRay {
  int64_t x_q8 = 0;  // micrometres, at z = 0
  int64_t y_q8 = 0;
  int64_t slope_x_q20 = 0;  // dx/dz
  int64_t slope_y_q20 = 0;
};

class RayTable {
 public:
  static constexpr int64_t kMaxPlaceQ8 = int64_t{1} << 28;   // 1 m: at() stays below 2^62
  static constexpr int64_t kMaxSlopeQ20 = int64_t{1} << 22;  // 76 degrees
  static constexpr int64_t kMaxShift = 4;

  // Lattice for a picture of this size in pixels; the last lines are on or beyond its last pixels.
  [[nodiscard]] static GridSize lattice_of(GridSize size_px, int shift);
  // `rays`: [y][x][4] on that lattice. `what` names them in the error: kBadInput beyond 1 m or 76 degrees.
  [[nodiscard]] static Result<RayTable> load(std::span<const int32_t> rays, GridSize size_px, int shift,
                                             const std::string& what);

  // Returns the ray through an image position in pixels.
  [[nodiscard]] PadRay at(int64_t px_x_q16, int64_t px_y_q16) const;

 private:
  GridSize size_px_;
  int shift_ = 0;  // log2 of the lattice step, pixels
  GridSize lattice_;
  std::vector<int32_t> rays_;  // [y][x][4]
};

}  // namespace ruffini
