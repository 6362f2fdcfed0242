// Estimates depth from the markers' motion alone, for boards without side light ([depth] source = "markers").
//
//   u_z    = D d            block program `marker_depth.*`; d: node displacement for u_z = 0, x and y interleaved
//   u_x, y = d + (X + d) u_z / H                        removes the part due to perspective (pinhole_nodes.h)
//
// D is the best linear estimate over simulated touches (host/ruffini/estimators/operator/marker_depth.py): the lateral
// spread of a nearly incompressible layer depends on how deep it is pressed, and perspective adds to it. A sharp dent
// causes little of either, so its depth is underestimated. There is no unknown constant, since markers far from a touch
// do not move. Not in the paper. Frame thread; no allocation after load.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "base/result.h"
#include "board/settings.h"
#include "estimators/pinhole_nodes.h"
#include "image/displacement.h"
#include "solve/block_program.h"
#include "store/calibration.h"

namespace ruffini {

class MarkerDepth {
 public:
  // Returns kBadInput if the tables do not fit the board's nodes, kRefused if the calibration has kind `camera`, whose
  // rays are not those of a pinhole.
  [[nodiscard]] static Result<MarkerDepth> load(const Calibration& calibration, const BoardSettings& board);

  // `node`: displacement with u_z = 0 in, complete displacement out.
  void run(std::span<NodeDisplacement> node, SaturationCounter& saturations);

 private:
  MarkerDepth(BlockProgram program, PinholeNodes nodes);

  BlockProgram program_;
  PinholeNodes nodes_;
  std::vector<int16_t> seen_;
  std::vector<int64_t> wide_;
};

}  // namespace ruffini
