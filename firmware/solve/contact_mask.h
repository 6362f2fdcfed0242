// Where the pad is touched, from a field of nodal forces.
//
//   pressed = f_z < -threshold
//   opened  = nodes of any 2 x 2 square of pressed nodes      (single noisy nodes vanish)
//   mask    = opened, grown by one node in all 8 directions
//
// Empty when fewer than min_nodes are opened. Frame thread; no allocation after the constructor.
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
  ContactMask(GridSize nodes, int64_t threshold_lsb, int64_t min_nodes);

  // 1 where touched; valid until the next call.
  std::span<const uint8_t> find(std::span<const NodeForce> force);

 private:
  GridSize nodes_;
  int64_t threshold_lsb_;
  int64_t min_nodes_;
  std::vector<uint8_t> opened_;
  std::vector<uint8_t> mask_;
};

}  // namespace ruffini
