#include "estimators/marker_depth.h"

#include <utility>

namespace ruffini {
Result<MarkerDepth> MarkerDepth::load(const Calibration& calibration, const BoardSettings& board) {
  if (calibration.has_kind("camera")) {
    return Error{ErrorKind::kRefused,
                 "calibration file: depth from markers knows the board's pinhole only, not the kind camera: leave "
                 "one of them out"};
  }
  PinholeNodes nodes(board);
  const int n = static_cast<int>(nodes.size());
  auto program = BlockProgram::load(calibration, "marker_depth", 2 * n, n);
  if (!program) return program.error();
  return MarkerDepth(std::move(program).value(), std::move(nodes));
}

MarkerDepth::MarkerDepth(BlockProgram program, PinholeNodes nodes)
    : program_(std::move(program)), nodes_(std::move(nodes)), seen_(2 * nodes_.size()), wide_(nodes_.size()) {}

void MarkerDepth::run(std::span<NodeDisplacement> node, SaturationCounter& saturations) {
  for (size_t i = 0; i < node.size(); ++i) {
    seen_[2 * i] = node[i].x.raw();
    seen_[2 * i + 1] = node[i].y.raw();
  }
  program_.run(seen_, wide_);
  for (size_t i = 0; i < node.size(); ++i) {
    nodes_.lift(node[i], i, saturate_raw<int16_t>(wide_[i], saturations), saturations);
  }
}

}  // namespace ruffini
