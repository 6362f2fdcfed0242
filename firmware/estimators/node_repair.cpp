#include "estimators/node_repair.h"

#include <cstdlib>

#include "base/filled.h"

namespace ruffini {
namespace {

// An outlier keeps its u_z unless it is off by twice the tolerance of u_x and u_y: depth often comes from another
// source.
constexpr int32_t kDepthOverShear = 2;

}  // namespace

NodeRepair::NodeRepair(const BoardSettings& board, GridSize nodes)
    : repair_(nodes),
      least_outlier_q3_(FieldRepair::least_q3(board.pad.size_x_um / (board.grid.n_x - 1),
                                              board.pad.size_y_um / (board.grid.n_y - 1), board.pad.thickness_um)),
      repaired_(static_cast<size_t>(nodes.count())) {}

void NodeRepair::run(std::span<NodeDisplacement> displacement, std::span<uint8_t> filled) {
  const auto is_measured = [](const NodeDisplacement& u) {
    return u.x.raw() != kNotMeasured && u.y.raw() != kNotMeasured && u.z.raw() != kNotMeasured;
  };
  for (size_t i = 0; i < displacement.size(); ++i) {
    const NodeDisplacement& u = displacement[i];
    filled[i] = is_measured(u) ? 0 : 1;
    repaired_[i] = is_measured(u) ? FieldValue{u.x.raw(), u.y.raw(), u.z.raw()} : FieldValue{};
  }
  repair_.run(repaired_, filled, least_outlier_q3_);
  for (size_t i = 0; i < displacement.size(); ++i) {
    if (filled[i] == 0) continue;
    NodeDisplacement& u = displacement[i];
    const auto um = [](int32_t q3) { return DisplacementUm::from_raw(static_cast<int16_t>(q3)); };
    // Until here `filled` was what the repair found
    const bool is_depth_good = filled[i] == FieldRepair::kOutlier &&
                               std::abs(u.z.raw() - repaired_[i].z) <= kDepthOverShear * least_outlier_q3_;
    u = {um(repaired_[i].x), um(repaired_[i].y), is_depth_good ? u.z : um(repaired_[i].z)};
    filled[i] = is_depth_good ? kShearFilled : kAllFilled;
  }
}

}  // namespace ruffini
