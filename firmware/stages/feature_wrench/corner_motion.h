// Detects motion of the camera against the pad from its corners, for boards whose wrench is linear in the markers'
// shifts.
//
// Top and two sides of a pad are free at its corner: without stress there is no strain, wherever a contact presses. A
// zoom looks like strain everywhere. For each corner, least squares over kSide x kSide markers (0 if more than a
// quarter of them are lost):
//   shift    mean displacement
//   turn     (du_y/dx - du_x/dy) / 2
//   zoom     (du_x/dx + du_y/dy) / 2 =: s; a wide contact stretches the corner, and more so over kWide x kWide markers:
//            the nearer to zero of s and s + 7/4 (s - s_wide) where these agree in sign, else 0
// Each is what three of four corners have in common (estimators/common_part.h). What it adds to the force along an axis
// follows from the wrench's own gain, R = dF/d(shift, turn, zoom):
//   dF = |R_x| |shift x| + |R_y| |shift y| + |R_turn| |turn| + |R_zoom| (|zoom| + turn^2 / 2)
// moved: dF > kMinUn + (|F_x| + |F_y| + |F_z|) / kPart along any axis. turn^2 / 2: a turned picture is a smaller one.
//
// Presses of 0.05 to 70 N on the twin of a soft pad, discs, balls and squares of 6 to 20 mm, sheared and turned, leave
// at most 0.06 of their force, or 0.05 N. Limits: a contact that reaches two corners; a smaller effect; what a kernel
// adds to the gain (stages/feature_wrench/kernel_map.h) is not counted.
// Frame thread; no allocation after the constructor but in learn(). Not in the papers.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "estimators/wrench.h"
#include "image/markers.h"
#include "stages/feature_wrench/feature_wrench.h"

namespace ruffini {

class CornerMotion {
 public:
  static constexpr int kSide = 7;
  static constexpr int kWide = 9;
  static constexpr int kMinMarkers = 2 * kWide;  // markers along each axis

  // What three corners have in common, without sign: px Q16, and Q20.
  struct Motion {
    int64_t shift_x_q16 = 0;
    int64_t shift_y_q16 = 0;
    int64_t turn_q20 = 0;
    int64_t zoom_q20 = 0;
  };

  explicit CornerMotion(GridSize lattice) : lattice_(lattice) {}

  // Sets a new rest image: marker positions, and the response of the wrench to motions.
  void learn(std::span<const Marker> markers, const FeatureWrench& wrench);
  [[nodiscard]] Motion motion(std::span<const Marker> markers) const;
  // Precondition: learn() was called. Always false with fewer than kMinMarkers markers.
  [[nodiscard]] bool has_moved(std::span<const Marker> markers, const Wrench& wrench) const;

 private:
  static constexpr size_t kMotions = 4;
  static constexpr size_t kAxes = 3;
  struct Corner {
    std::array<int64_t, kMotions> value{};  // as Motion, with sign
  };
  [[nodiscard]] bool is_large_enough() const { return lattice_.n_x >= kMinMarkers && lattice_.n_y >= kMinMarkers; }
  [[nodiscard]] Corner corner(std::span<const Marker> markers, int first_x, int first_y, int side) const;

  GridSize lattice_;
  int64_t pitch_x_q16_ = 1;
  int64_t pitch_y_q16_ = 1;
  // uN a pixel of shift, and a 64th of turn and zoom.
  std::array<std::array<int64_t, kAxes>, kMotions> response_un_{};
};

}  // namespace ruffini
