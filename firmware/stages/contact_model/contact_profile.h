// Features of one contact in the flow of a texture: density of the patches, centre, and outward displacement of the
// surroundings at each distance from the centre.
//
//   fall      decrease of the patches' density: to first order the divergence of the flow, central differences on the
//             lattice, smoothed by (1 2 1) both ways; Q16
//   centre    centroid of the fall above 3/10 of its largest value
//   radial    u_r, the angular mean of the flow's radial component on kRings circles around the centre, spaced by a
//             36th of the pad's shorter side; flow between the patches by Catmull-Rom. A point counts only together
//             with the opposite one, so that displacement common to all patches (shear, perspective off the axis)
//             cancels
//   size      sqrt(sum of u_r^2)
//   flow      magnitude of the mean displacement of all patches: the paper's S_t (eq. 7) over their number
//
// Lost patches are filled from their neighbours (image/markers.h); `lost_1e3` is their share within the circles. Not in
// the paper, which uses the density alone. Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "board/settings.h"
#include "core/results.h"
#include "image/markers.h"

namespace ruffini {

class ContactProfile {
 public:
  static constexpr int64_t kRingsAcross = 36;

  explicit ContactProfile(const BoardSettings& board);

  [[nodiscard]] const Profile& run(std::span<const Marker> markers);
  // Smoothed fall of the density at each patch of the last frame, Q16.
  [[nodiscard]] std::span<const int32_t> fall() const { return fall_; }
  // Displacements of the patches in the last frame.
  [[nodiscard]] std::span<const FlowPoint> flow() const { return flow_; }

 private:
  using Point = FlowPoint;
  void load_flow(std::span<const Marker> markers);
  void find_fall();
  [[nodiscard]] Point center() const;
  [[nodiscard]] int64_t mean_flow_q4() const;
  [[nodiscard]] bool is_inside(const Point& at) const;
  [[nodiscard]] Point flow_at(const Point& at) const;
  [[nodiscard]] int64_t radial_q4(const Point& middle, size_t ring) const;
  [[nodiscard]] int64_t lost_1e3(std::span<const Marker> markers, const Point& middle) const;
  [[nodiscard]] Point place(int x, int y) const;
  [[nodiscard]] const Point& flow(int x, int y) const;

  GridSize lattice_;
  int64_t px_to_um_q20_;  // from a displacement in px Q16 to um Q4
  int64_t ring_um_;
  Point pitch_;
  Point first_;  // first patch of the lattice, and below the last one
  Point last_;
  std::vector<Point> flow_;
  std::vector<int32_t> raw_fall_;
  std::vector<int32_t> fall_;
  Profile profile_;
};

}  // namespace ruffini
