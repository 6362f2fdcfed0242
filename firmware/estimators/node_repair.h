// Repairs a node displacement given by a caller, for the solve alone: fills nodes that were not measured or that
// contradict their neighbours (image/field_repair.h). The nodes of a camera frame need no repair, since they come from
// repaired markers.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "board/settings.h"
#include "image/displacement.h"
#include "image/field_repair.h"

namespace ruffini {

class NodeRepair {
 public:
  static constexpr int16_t kNotMeasured = INT16_MIN;

  NodeRepair(const BoardSettings& board, GridSize nodes);

  // A node is missing if any component is kNotMeasured. Sets filled (base/filled.h) of each node.
  void run(std::span<NodeDisplacement> displacement, std::span<uint8_t> filled);

 private:
  FieldRepair repair_;
  int32_t least_outlier_q3_;
  std::vector<FieldValue> repaired_;
};

}  // namespace ruffini
