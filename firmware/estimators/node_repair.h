// Fills what a caller's displacement of the nodes lacks, for the solve alone: nodes that were not measured or contradict
// their neighbours (image/field_repair.h). The nodes of a frame need none: they come from markers that were repaired.
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

  // A node of which a component is kNotMeasured is missing. Sets is_filled to 1 where a node is filled, else to 0.
  void run(std::span<NodeDisplacement> displacement, std::span<uint8_t> is_filled);

 private:
  FieldRepair repair_;
  int32_t least_outlier_q3_;
  std::vector<FieldValue> repaired_;
};

}  // namespace ruffini
