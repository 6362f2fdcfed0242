#include "solve/contact_mask.h"

#include <algorithm>

namespace ruffini {

ContactMask::ContactMask(GridSize nodes, int64_t threshold_lsb, int64_t min_nodes)
    : nodes_(nodes),
      threshold_lsb_(threshold_lsb),
      min_nodes_(min_nodes),
      opened_(static_cast<size_t>(nodes.count())),
      mask_(static_cast<size_t>(nodes.count())) {}

std::span<const uint8_t> ContactMask::find(std::span<const NodeForce> force) {
  std::fill(opened_.begin(), opened_.end(), uint8_t{0});
  std::fill(mask_.begin(), mask_.end(), uint8_t{0});
  const auto at = [&](int x, int y) { return static_cast<size_t>(y * nodes_.n_x + x); };
  const auto is_pressed = [&](int x, int y) { return force[at(x, y)].z < -threshold_lsb_; };
  for (int y = 0; y + 1 < nodes_.n_y; ++y) {
    for (int x = 0; x + 1 < nodes_.n_x; ++x) {
      if (is_pressed(x, y) && is_pressed(x + 1, y) && is_pressed(x, y + 1) && is_pressed(x + 1, y + 1)) {
        opened_[at(x, y)] = opened_[at(x + 1, y)] = opened_[at(x, y + 1)] = opened_[at(x + 1, y + 1)] = 1;
      }
    }
  }
  if (std::count(opened_.begin(), opened_.end(), uint8_t{1}) < min_nodes_) return mask_;
  for (int y = 0; y < nodes_.n_y; ++y) {
    for (int x = 0; x < nodes_.n_x; ++x) {
      if (opened_[at(x, y)] == 0) continue;
      for (int v = std::max(y - 1, 0); v <= std::min(y + 1, nodes_.n_y - 1); ++v) {
        for (int u = std::max(x - 1, 0); u <= std::min(x + 1, nodes_.n_x - 1); ++u) mask_[at(u, v)] = 1;
      }
    }
  }
  return mask_;
}

}  // namespace ruffini
