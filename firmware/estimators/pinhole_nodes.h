// The observed nodes as the board's pinhole sees them: what nearness does to where they seem to be.
//
//   u_z += c,  u_xy += (X + u_xy) c / H       of a node at X whose depth was taken for c too little; rounded half up
//
// Exact where u_z was zero; else to first order in u_z / H.
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
  // Lifts a node by `c_q3`, 1/8 um; saturating, counted.
  void lift(NodeDisplacement& node, size_t i, int64_t c_q3, SaturationCounter& saturations) const;

 private:
  struct Place {
    int64_t x_q3 = 0;  // from the pad's centre, 1/8 um
    int64_t y_q3 = 0;
  };
  [[nodiscard]] DisplacementUm sideways(DisplacementUm seen, int64_t place_q3, int64_t c_q3,
                                        SaturationCounter& saturations) const;

  int64_t standoff_q3_;
  std::vector<Place> place_;
};

}  // namespace ruffini
