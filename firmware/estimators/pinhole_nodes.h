// Corrects the observed nodes for perspective: a surface closer to the pinhole appears displaced.
//
//   u_z += c,  u_xy += (X + u_xy) c / H       for a node at X whose depth is c too small; rounded half up
//
// Exact if u_z was zero, otherwise to first order in u_z / H.
#pragma once

#include <cstdint>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "image/displacement.h"

namespace ruffini {

class PinholeNodes {
 public:
  explicit PinholeNodes(const BoardSettings& board);

  [[nodiscard]] size_t size() const { return place_.size(); }
  // Lifts a node by `c_q3` (1/8 um); saturates and counts.
  void lift(NodeDisplacement& node, size_t i, int64_t c_q3, SaturationCounter& saturations) const;

 private:
  struct Place {
    int64_t x_q3 = 0;  // relative to the pad's centre, 1/8 um
    int64_t y_q3 = 0;
  };
  [[nodiscard]] DisplacementUm sideways(DisplacementUm seen, int64_t place_q3, int64_t c_q3,
                                        SaturationCounter& saturations) const;

  int64_t standoff_q3_;
  std::vector<Place> place_;
};

}  // namespace ruffini
