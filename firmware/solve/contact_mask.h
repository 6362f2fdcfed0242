// Degree of contact at each node, from a field of nodal forces: 0 for none to 128 (Q7) for certain.
//
//   T_k     = strongest -f_z of the frame / 8, at least `least_k`, at most the board's threshold
//   opened  = largest over k of (o_k - T_k) / T_k, clamped to 0..1; o_k = largest over the k x k squares at the node of
//             the smallest -f_z in the square, k = 2, 4, 8 (single noisy nodes vanish)
//             zero if fewer than min_nodes are opened
//             for the strongest node also (-f_z - A) / A, clamped to 0..1     A = `alone`
//   mask    = largest opened of the node and its 8 neighbours
//
// `least_2` and `alone` are levels that the noise of this unit's untouched frames rarely exceeds (kind `contact` of
// proto/CALIBRATION.md). If the calibration has them, they apply to all k, so k = 2 decides. Otherwise `least_k` is the
// board's threshold divided by 1, 4 and 16: noise seldom raises 4 x 4 or 8 x 8 nodes at once, and a flat punch presses
// lightly on many nodes. T is the board's threshold while the light drifts. The eighth of the strongest force keeps
// residuals of the linear estimate around a strong contact from counting as a second contact.
//
// Every step is continuous in the force, so that a node at the threshold cannot switch the second pass on and off.
// Cost: 3 passes over the nodes for each k whose T the strongest node reaches. Frame thread; no allocation after the
// constructor.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

// Force of one node, x, y, z, in steps of the board's force_lsb_un.
struct NodeForce {
  int32_t x = 0;
  int32_t y = 0;
  int32_t z = 0;
};

// The board's contact threshold in force steps, at least 1.
[[nodiscard]] constexpr int64_t contact_threshold_lsb(int64_t threshold_un, int64_t force_lsb_un) {
  return std::max<int64_t>(threshold_un / force_lsb_un, 1);
}

class ContactMask {
 public:
  static constexpr int kFraction = 7;
  static constexpr int64_t kFull = int64_t{1} << kFraction;

  // threshold_lsb > 0
  ContactMask(GridSize nodes, int64_t threshold_lsb, int64_t min_nodes);

  // Loads the noise levels of kind `contact`. Errors: kBadInput.
  Status load_noise(const Calibration& calibration, int64_t force_lsb_un);

  // Returns one value per node, valid until the next call. is_steady: the noise is as it was when it was calibrated.
  std::span<const uint8_t> find(std::span<const NodeForce> force, bool is_steady = true);
  // T_8 of the last field, the lowest threshold.
  [[nodiscard]] int64_t threshold_lsb() const { return frame_threshold_lsb_; }
  // True if the strongest node of the last field exceeds a quarter of the board's threshold.
  [[nodiscard]] bool is_pressed() const { return is_pressed_; }

 private:
  [[nodiscard]] int64_t threshold_of(int side, int64_t strongest_lsb, bool is_steady) const;
  void open(int side, int64_t threshold);

  GridSize nodes_;
  int64_t threshold_lsb_;
  int64_t min_nodes_;
  std::optional<int64_t> noise_lsb_;
  int64_t alone_lsb_ = int64_t{1} << 40;  // larger than any force
  int64_t frame_threshold_lsb_;
  bool is_pressed_ = false;
  std::vector<int32_t> smallest_;  // smallest -f_z of the square that begins at this node
  std::vector<int32_t> largest_;   // o_k
  std::vector<uint8_t> opened_;
  std::vector<uint8_t> mask_;
};

}  // namespace ruffini
