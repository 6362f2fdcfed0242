// The free constant of depth from light, by a table ([depth] gauge = "spacing", "volume" or "both").
//
//   c = (w . u + 2^(s-1)) >> s       u of all nodes as the stage displacement has it, any constant in it; `gauge.*`
//   every node is lifted by c (pinhole_nodes.h), and so is every cell of the depth
//
// w is made by the host (host/ruffini/estimators/operator/depth_gauge.py): what the spacing of the markers says of nearness, what
// the rubber's volume says of the mean of a dent's shape, or both. Not in the paper.
// Frame thread; no allocation after load.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "base/result.h"
#include "board/settings.h"
#include "estimators/pinhole_nodes.h"
#include "image/displacement.h"
#include "store/calibration.h"

namespace ruffini {

class DepthGauge {
 public:
  // kBadInput where the table does not fit the board's nodes; kRefused beside the kind `camera`, whose rays are no
  // pinhole's.
  [[nodiscard]] static Result<DepthGauge> load(const Calibration& calibration, const BoardSettings& board);

  // The constant, 1/8 um.
  [[nodiscard]] int64_t constant_q3(std::span<const NodeDisplacement> node) const;
  // Finds the constant and lifts nodes and depth by it; what does not fit saturates, counted.
  void run(std::span<NodeDisplacement> node, std::span<DisplacementUm> depth, SaturationCounter& saturations) const;

 private:
  struct Weight {
    int16_t x = 0;
    int16_t y = 0;
    int16_t z = 0;
  };

  DepthGauge(PinholeNodes nodes, int shift) : nodes_(std::move(nodes)), shift_(shift) {}

  PinholeNodes nodes_;
  int shift_;
  std::vector<Weight> weight_;
};

}  // namespace ruffini
