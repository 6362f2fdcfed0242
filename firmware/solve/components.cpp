#include "solve/components.h"

#include <algorithm>

namespace ruffini {

Components::Components(GridSize nodes)
    : nodes_(nodes), label_(static_cast<size_t>(nodes.count())), stack_(static_cast<size_t>(nodes.count())) {}

std::span<const uint16_t> Components::find(std::span<const uint8_t> mask) {
  count_ = 0;
  std::fill(label_.begin(), label_.end(), uint16_t{0});
  for (size_t seed = 0; seed < mask.size(); ++seed) {
    if (mask[seed] == 0 || label_[seed] != 0) continue;
    ++count_;
    grow(seed, mask);
  }
  return label_;
}

void Components::grow(size_t seed, std::span<const uint8_t> mask) {
  size_t n_waiting = 0;
  label_[seed] = static_cast<uint16_t>(count_);
  stack_[n_waiting++] = static_cast<uint32_t>(seed);
  while (n_waiting > 0) {
    const auto node = static_cast<int>(stack_[--n_waiting]);
    const int x = node % nodes_.n_x;
    const int y = node / nodes_.n_x;
    for (int v = std::max(y - 1, 0); v <= std::min(y + 1, nodes_.n_y - 1); ++v) {
      for (int u = std::max(x - 1, 0); u <= std::min(x + 1, nodes_.n_x - 1); ++u) {
        const auto at = static_cast<size_t>(v * nodes_.n_x + u);
        if (mask[at] == 0 || label_[at] != 0) continue;
        label_[at] = static_cast<uint16_t>(count_);
        stack_[n_waiting++] = static_cast<uint32_t>(at);
      }
    }
  }
}

}  // namespace ruffini
