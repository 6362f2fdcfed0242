#include "solve/contact_mask.h"

#include <algorithm>
#include <iterator>

namespace ruffini {

ContactMask::ContactMask(GridSize nodes, int64_t threshold_lsb, int64_t min_nodes)
    : nodes_(nodes),
      threshold_lsb_(threshold_lsb),
      min_nodes_(min_nodes),
      pressed_(static_cast<size_t>(nodes.count())),
      opened_(static_cast<size_t>(nodes.count())),
      mask_(static_cast<size_t>(nodes.count())) {}

std::span<const uint8_t> ContactMask::find(std::span<const NodeForce> force) {
  std::fill(opened_.begin(), opened_.end(), uint8_t{0});
  std::fill(mask_.begin(), mask_.end(), uint8_t{0});
  for (size_t i = 0; i < pressed_.size(); ++i) {
    const int64_t beyond = std::clamp<int64_t>(-int64_t{force[i].z} - threshold_lsb_, 0, threshold_lsb_);
    pressed_[i] = static_cast<uint8_t>((beyond * kFull + threshold_lsb_ - 1) / threshold_lsb_);
  }
  const auto at = [&](int x, int y) { return static_cast<size_t>(y * nodes_.n_x + x); };
  const auto raise = [](uint8_t& value, uint8_t to) { value = std::max(value, to); };
  for (int y = 0; y + 1 < nodes_.n_y; ++y) {
    for (int x = 0; x + 1 < nodes_.n_x; ++x) {
      const uint8_t smallest =
          std::min({pressed_[at(x, y)], pressed_[at(x + 1, y)], pressed_[at(x, y + 1)], pressed_[at(x + 1, y + 1)]});
      for (const size_t i : {at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)}) raise(opened_[i], smallest);
    }
  }
  if (std::ssize(opened_) - std::count(opened_.begin(), opened_.end(), uint8_t{0}) < min_nodes_) return mask_;
  for (int y = 0; y < nodes_.n_y; ++y) {
    for (int x = 0; x < nodes_.n_x; ++x) {
      if (opened_[at(x, y)] == 0) continue;
      for (int v = std::max(y - 1, 0); v <= std::min(y + 1, nodes_.n_y - 1); ++v) {
        for (int u = std::max(x - 1, 0); u <= std::min(x + 1, nodes_.n_x - 1); ++u) {
          raise(mask_[at(u, v)], opened_[at(x, y)]);
        }
      }
    }
  }
  return mask_;
}

}  // namespace ruffini
