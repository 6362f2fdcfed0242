// Markers and depth -> displacement of the nodes, in the pad's frame, micrometres.
//
//   marker:  u = [(p - p_0) H + (p - c) u_z] / f, u_z = depth read where the marker is now (bilinear)
//   lattice -> nodes: Catmull-Rom along each axis, linear beyond the outermost markers (at most one pitch)
//   node:    u_z = depth read at p = c + f (X + u_xy) / (H + u_z), two rounds
//
// Markers are Lagrangian and depth Eulerian: both readings are at the deformed place. Not in the paper.
// Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "image/markers.h"

namespace ruffini {

struct NodeDisplacement {
  DisplacementUm x;
  DisplacementUm y;
  DisplacementUm z;
};

class Displacement {
 public:
  explicit Displacement(const BoardSettings& board);

  // `depth` on the depth grid, or empty where depth is not measured (u_z = 0).
  void run(std::span<const Marker> markers, std::span<const DisplacementUm> depth,
           std::span<NodeDisplacement> out, SaturationCounter& saturations);

  [[nodiscard]] GridSize nodes() const { return nodes_; }

 private:
  // Four lattice lines and their Q14 weights.
  struct Taps {
    std::array<int, 4> line{};
    std::array<int64_t, 4> weight{};
  };
  static Taps taps(int64_t position_q16, int n_lines);

  [[nodiscard]] int64_t read_depth(std::span<const DisplacementUm> depth, int64_t px_x_q16, int64_t px_y_q16) const;
  void markers_to_pad(std::span<const Marker> markers, std::span<const DisplacementUm> depth,
                      SaturationCounter& saturations);

  CameraSettings camera_;
  int step_px_;
  GridSize depth_grid_;
  GridSize lattice_;
  GridSize nodes_;                    // observed ones
  int64_t center_x_q16_;
  int64_t center_y_q16_;
  int64_t inverse_focal_q32_;         // 1 / px
  std::vector<Taps> taps_x_;          // per node column
  std::vector<Taps> taps_y_;          // per node row
  std::vector<int64_t> node_x_q3_;    // from the pad's centre, micrometres
  std::vector<int64_t> node_y_q3_;
  std::vector<NodeDisplacement> lattice_u_;
};

}  // namespace ruffini
