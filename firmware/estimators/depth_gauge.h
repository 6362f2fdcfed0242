// Determines the unknown constant of depth from light by a table ([depth] gauge = "spacing", "volume" or "both").
//
//   c = (w . u + 2^(s-1)) >> s       u: all nodes of the stage displacement, with an arbitrary constant; `gauge.*`
//   each node (pinhole_nodes.h) and each cell of the depth is lifted by c
//
// The host computes w (host/ruffini/estimators/operator/depth_gauge.py) from the spacing of the markers, which shows
// their distance, from the rubber's volume, which fixes the mean of a dent's shape, or from both. Not in the paper.
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
  // Returns kBadInput if the table does not fit the board's nodes, kRefused if the calibration has kind `camera`, whose
  // rays are not those of a pinhole.
  [[nodiscard]] static Result<DepthGauge> load(const Calibration& calibration, const BoardSettings& board);

  // Returns the constant in 1/8 um.
  [[nodiscard]] int64_t constant_q3(std::span<const NodeDisplacement> node) const;
  // Computes the constant and lifts nodes and depth by it; saturates and counts.
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
