#include "estimators/marker_depth.h"

#include <utility>

namespace ruffini {
namespace {

NodeRange observed_x(const BoardSettings& board) {
  return observed_nodes(board.grid.n_x, board.pad.size_x_um, board.window.min_x_um, board.window.max_x_um);
}

NodeRange observed_y(const BoardSettings& board) {
  return observed_nodes(board.grid.n_y, board.pad.size_y_um, board.window.min_y_um, board.window.max_y_um);
}

}  // namespace

Result<MarkerDepth> MarkerDepth::load(const Calibration& calibration, const BoardSettings& board) {
  if (calibration.has_kind("camera")) {
    return Error{ErrorKind::kRefused,
                 "calibration file: depth from markers knows the board's pinhole only, not the kind camera: leave "
                 "one of them out"};
  }
  const int n = observed_x(board).count * observed_y(board).count;
  auto program = BlockProgram::load(calibration, "marker_depth", 2 * n, n);
  if (!program) return program.error();
  return MarkerDepth(std::move(program).value(), board);
}

MarkerDepth::MarkerDepth(BlockProgram program, const BoardSettings& board)
    : program_(std::move(program)), standoff_q3_(board.camera.standoff_um * 8) {
  const auto place_q3 = [](int64_t i, int64_t size_um, int64_t n) {
    return floor_div(4 * (2 * i - (n - 1)) * size_um, n - 1);
  };
  const NodeRange x = observed_x(board);
  const NodeRange y = observed_y(board);
  for (int row = y.first; row < y.first + y.count; ++row) {
    for (int column = x.first; column < x.first + x.count; ++column) {
      place_.push_back(
          {place_q3(column, board.pad.size_x_um, board.grid.n_x), place_q3(row, board.pad.size_y_um, board.grid.n_y)});
    }
  }
  seen_.resize(2 * place_.size());
  wide_.resize(place_.size());
}

DisplacementUm MarkerDepth::without_perspective(DisplacementUm seen, int64_t place_q3, int64_t depth_q3,
                                                SaturationCounter& saturations) const {
  const int64_t hidden_q3 = floor_div(2 * (place_q3 + seen.raw()) * depth_q3 + standoff_q3_, 2 * standoff_q3_);
  return DisplacementUm::from_raw(saturate_raw<int16_t>(seen.raw() + hidden_q3, saturations));
}

void MarkerDepth::run(std::span<NodeDisplacement> node, SaturationCounter& saturations) {
  for (size_t i = 0; i < node.size(); ++i) {
    seen_[2 * i] = node[i].x.raw();
    seen_[2 * i + 1] = node[i].y.raw();
  }
  program_.run(seen_, wide_);
  for (size_t i = 0; i < node.size(); ++i) {
    const auto depth = DisplacementUm::from_raw(saturate_raw<int16_t>(wide_[i], saturations));
    node[i] = {without_perspective(node[i].x, place_[i].x_q3, depth.raw(), saturations),
               without_perspective(node[i].y, place_[i].y_q3, depth.raw(), saturations), depth};
  }
}

}  // namespace ruffini
