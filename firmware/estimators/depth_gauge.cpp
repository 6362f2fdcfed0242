#include "estimators/depth_gauge.h"

#include <algorithm>
#include <utility>

namespace ruffini {
namespace {

constexpr int kMaxShift = 40;

}  // namespace

Result<DepthGauge> DepthGauge::load(const Calibration& calibration, const BoardSettings& board) {
  if (calibration.has_kind("camera")) {
    return Error{ErrorKind::kRefused,
                 "calibration file: the depth's gauge knows the board's pinhole only, not the kind camera: leave one "
                 "of them out, or choose [depth] gauge margin or mean"};
  }
  PinholeNodes nodes(board);
  const auto shift = calibration.integer("gauge.shift", 1, kMaxShift);
  if (!shift) return shift.error();
  const auto table = calibration.tensor("gauge.weight", Tensor::Type::kI16, {static_cast<int64_t>(nodes.size()), 3});
  if (!table) return table.error();
  DepthGauge gauge(std::move(nodes), static_cast<int>(shift.value()));
  const std::span<const int16_t> weight = table.value()->as<int16_t>();
  for (size_t i = 0; i + 2 < weight.size(); i += 3) {
    gauge.weight_.push_back({weight[i], weight[i + 1], weight[i + 2]});
  }
  return gauge;
}

// Bound: |w . u| < 3 n 2^30.
int64_t DepthGauge::constant_q3(std::span<const NodeDisplacement> node) const {
  int64_t sum = 0;
  for (size_t i = 0; i < node.size(); ++i) {
    const Weight& w = weight_[i];
    sum += int64_t{w.x} * node[i].x.raw() + int64_t{w.y} * node[i].y.raw() + int64_t{w.z} * node[i].z.raw();
  }
  return round_shift(sum, shift_);
}

void DepthGauge::run(std::span<NodeDisplacement> node, std::span<DisplacementUm> depth,
                     SaturationCounter& saturations) const {
  const int64_t c_q3 = saturate_raw<int16_t>(constant_q3(node), saturations);
  for (size_t i = 0; i < node.size(); ++i) nodes_.lift(node[i], i, c_q3, saturations);
  std::transform(depth.begin(), depth.end(), depth.begin(), [&](DisplacementUm z) {
    return DisplacementUm::from_raw(saturate_raw<int16_t>(z.raw() + c_q3, saturations));
  });
}

}  // namespace ruffini
