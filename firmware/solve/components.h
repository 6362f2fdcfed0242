// Separates the contacts of a mask: 8-connected components, numbered from 1 in scan order of their first node.
//
// Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

class Components {
 public:
  explicit Components(GridSize nodes);

  // Returns one number per node, 0 if the mask is 0. Valid until the next call.
  std::span<const uint16_t> find(std::span<const uint8_t> mask);
  // Result of the last find(); all 0 before the first call.
  [[nodiscard]] std::span<const uint16_t> label() const { return label_; }
  [[nodiscard]] int count() const { return count_; }
  // Upper bound of the number of components on a grid: any two are separated by a line of zeros.
  [[nodiscard]] static int max_count(GridSize nodes) { return ((nodes.n_x + 1) / 2) * ((nodes.n_y + 1) / 2); }

 private:
  void grow(size_t seed, std::span<const uint8_t> mask);

  GridSize nodes_;
  int count_ = 0;
  std::vector<uint16_t> label_;
  std::vector<uint32_t> stack_;
};

}  // namespace ruffini
