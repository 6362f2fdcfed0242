// Where the pad is touched and how surely, from a field of nodal forces: 0 not, up to 128 (Q7) surely.
//
//   pressed = (-f_z - T) / T, clamped to 0..1      T = threshold
//   opened  = largest over the 2 x 2 squares at the node of the smallest pressed in the square
//             (single noisy nodes vanish)
//   mask    = largest opened of the node and its 8 neighbours
//
// Every step is continuous in the force, so that a node at the threshold cannot flip the second pass.
// All zero when fewer than min_nodes are opened. Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

// fx, fy, fz of one node in steps of the board's force_lsb_un.
struct NodeForce {
  int32_t x = 0;
  int32_t y = 0;
  int32_t z = 0;
};

class ContactMask {
 public:
  static constexpr int kFraction = 7;
  static constexpr int64_t kFull = int64_t{1} << kFraction;

  // threshold_lsb > 0
  ContactMask(GridSize nodes, int64_t threshold_lsb, int64_t min_nodes);

  // One value a node; valid until the next call.
  std::span<const uint8_t> find(std::span<const NodeForce> force);

 private:
  GridSize nodes_;
  int64_t threshold_lsb_;
  int64_t min_nodes_;
  std::vector<uint8_t> pressed_;
  std::vector<uint8_t> opened_;
  std::vector<uint8_t> mask_;
};

}  // namespace ruffini
