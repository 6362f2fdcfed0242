// Computes the displacement of the nodes in the pad's frame, in micrometres, from markers and depth.
//
//   marker:  u = [(p - p_0) H + (p - c) u_z] / f, u_z = depth at the marker's current position (bilinear)
//            with a camera map (image/camera_map.h): u = A(p) + S(p) u_z - A(p_0), u_z at A(p) in the ideal pinhole's
//            view
//   lattice: outliers among neighbours are found; they and the lost markers are filled smoothly (image/field_repair.h)
//   markers -> nodes: image/marker_interpolation.h
//   node:    u_z = depth at p = c + f (X + u_xy) / (H + u_z), two rounds
//
// Markers are Lagrangian and depth is Eulerian: both are read at the deformed position. Not in the paper. Frame thread;
// no allocation after the constructor.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "image/camera_map.h"
#include "image/field_repair.h"
#include "image/marker_interpolation.h"
#include "image/markers.h"

namespace ruffini {

struct NodeDisplacement {
  DisplacementUm x;
  DisplacementUm y;
  DisplacementUm z;
};

class Displacement {
 public:
  // `map` must outlive this object; null if the board's own camera is an ideal pinhole. With a map, `board` is its
  // ideal board.
  explicit Displacement(const BoardSettings& board, const CameraMap* map = nullptr);

  // Computes the weights of the markers at each node. Call it before the first run() and when the rest image changes.
  void learn(std::span<const Marker> markers);

  // `depth`: on the depth grid, or empty if depth is not measured (u_z = 0).
  void run(std::span<const Marker> markers, std::span<const DisplacementUm> depth, std::span<NodeDisplacement> out,
           SaturationCounter& saturations);

  // Sets kShearFilled for each filled node, else kNothingFilled, for the markers and outliers of the last run()
  // (base/filled.h).
  void mark_filled(std::span<const Marker> markers, std::span<uint8_t> filled);

  [[nodiscard]] GridSize nodes() const { return nodes_.nodes(); }

 private:
  [[nodiscard]] int64_t to_pad_q3(int64_t length_um_px_q19) const;
  [[nodiscard]] NodeDisplacement at_node(size_t node, std::span<const DisplacementUm> depth,
                                         SaturationCounter& saturations) const;

  // Position of a marker relative to the pad's centre, and its displacement.
  [[nodiscard]] PadPoint rest_place(const Marker& marker) const;
  [[nodiscard]] NodeDisplacement by_pinhole(const Marker& marker, std::span<const DisplacementUm> depth,
                                            SaturationCounter& saturations) const;
  [[nodiscard]] NodeDisplacement by_map(const Marker& marker, const PadPoint& rest_q8,
                                        std::span<const DisplacementUm> depth, SaturationCounter& saturations) const;
  [[nodiscard]] int64_t read_depth(std::span<const DisplacementUm> depth, int64_t px_x_q16, int64_t px_y_q16) const;
  void repair(std::span<const Marker> markers, SaturationCounter& saturations);
  void markers_to_pad(std::span<const Marker> markers, std::span<const DisplacementUm> depth,
                      SaturationCounter& saturations);

  const CameraMap* map_;
  CameraSettings camera_;
  int step_px_;
  GridSize depth_grid_;
  MarkerInterpolation nodes_;
  int64_t center_x_q16_;
  int64_t center_y_q16_;
  int64_t inverse_focal_q32_;          // 1 / px
  int64_t um_to_px_q32_;               // at z = 0
  std::vector<PadPoint> rest_q3_;      // of each marker, relative to the pad's centre, micrometres
  std::vector<PadPoint> rest_ray_q8_;  // the same for the camera map
  std::vector<NodeDisplacement> marker_u_;
  int32_t least_outlier_q3_;
  std::optional<FieldRepair> repair_;  // of a lattice; none for scattered markers
  std::vector<FieldValue> shear_;      // of each marker, 1/8 um; z is unused
  std::vector<uint8_t> is_missing_;
};

}  // namespace ruffini
