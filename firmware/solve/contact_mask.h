// Where the pad is touched and how surely, from a field of nodal forces: 0 not, up to 128 (Q7) surely.
//
//   T_k     = strongest -f_z of the frame / 8, at least `least_k`, at most the board's threshold
//   opened  = largest over k of (o_k - T_k) / T_k, clamped to 0..1; o_k = largest over the k x k squares at the node of
//             the smallest -f_z in the square, k = 2, 4, 8 (single noisy nodes vanish)
//             zero when fewer than min_nodes are opened
//             of the strongest node also (-f_z - A) / A, clamped to 0..1      A = `alone`
//   mask    = largest opened of the node and its 8 neighbours
//
// `least_2` and `alone` are what the noise of untouched frames of this unit hardly ever reaches (kind `contact` of
// proto/CALIBRATION.md); all k have that then, so k = 2 decides. Without it `least_k` is the board's threshold over 1, 4, 16:
// what noise makes on 4 x 4 and on 8 x 8 nodes at once is smaller, and a flat punch presses on many nodes, on each one little.
// While the light drifts, T is the board's threshold. The eighth: what the linear estimate leaves around a strong contact is
// no second one.
//
// Every step is continuous in the force, so that a node at the threshold cannot flip the second pass.
// Work: 3 passes over the nodes for each k whose T the strongest node reaches. Frame thread; no allocation after the
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

// fx, fy, fz of one node in steps of the board's force_lsb_un.
struct NodeForce {
  int32_t x = 0;
  int32_t y = 0;
  int32_t z = 0;
};

// The board's threshold of a contact, in steps.
[[nodiscard]] constexpr int64_t contact_threshold_lsb(int64_t threshold_un, int64_t force_lsb_un) {
  return std::max<int64_t>(threshold_un / force_lsb_un, 1);
}

class ContactMask {
 public:
  static constexpr int kFraction = 7;
  static constexpr int64_t kFull = int64_t{1} << kFraction;

  // threshold_lsb > 0
  ContactMask(GridSize nodes, int64_t threshold_lsb, int64_t min_nodes);

  // What noise hardly ever reaches, from kind `contact`. Errors: kBadInput.
  Status load_noise(const Calibration& calibration, int64_t force_lsb_un);

  // One value a node; valid until the next call. is_steady: the noise is what it was when it was measured.
  std::span<const uint8_t> find(std::span<const NodeForce> force, bool is_steady = true);
  // T_8 of the last field: the smallest.
  [[nodiscard]] int64_t threshold_lsb() const { return frame_threshold_lsb_; }
  // The strongest node of the last field pressed harder than a quarter of the board's threshold.
  [[nodiscard]] bool is_pressed() const { return is_pressed_; }

 private:
  [[nodiscard]] int64_t threshold_of(int side, int64_t strongest_lsb, bool is_steady) const;
  void open(int side, int64_t threshold);

  GridSize nodes_;
  int64_t threshold_lsb_;
  int64_t min_nodes_;
  std::optional<int64_t> noise_lsb_;
  int64_t alone_lsb_ = int64_t{1} << 40;  // beyond any force
  int64_t frame_threshold_lsb_;
  bool is_pressed_ = false;
  std::vector<int32_t> smallest_;  // -f_z of the square whose first node this is
  std::vector<int32_t> largest_;   // o_k
  std::vector<uint8_t> opened_;
  std::vector<uint8_t> mask_;
};

}  // namespace ruffini
