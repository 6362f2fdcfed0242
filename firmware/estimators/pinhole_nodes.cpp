#include "estimators/pinhole_nodes.h"

namespace ruffini {

PinholeNodes::PinholeNodes(const BoardSettings& board) : standoff_q3_(board.camera.standoff_um * 8) {
  const auto place_q3 = [](int64_t i, int64_t size_um, int64_t n) {
    return floor_div(4 * (2 * i - (n - 1)) * size_um, n - 1);
  };
  const WindowSettings& w = board.window;
  const NodeRange x = observed_nodes(board.grid.n_x, board.pad.size_x_um, w.min_x_um, w.max_x_um);
  const NodeRange y = observed_nodes(board.grid.n_y, board.pad.size_y_um, w.min_y_um, w.max_y_um);
  for (int row = y.first; row < y.first + y.count; ++row) {
    for (int column = x.first; column < x.first + x.count; ++column) {
      place_.push_back(
          {place_q3(column, board.pad.size_x_um, board.grid.n_x), place_q3(row, board.pad.size_y_um, board.grid.n_y)});
    }
  }
}

DisplacementUm PinholeNodes::sideways(DisplacementUm seen, int64_t place_q3, int64_t c_q3,
                                      SaturationCounter& saturations) const {
  const int64_t hidden_q3 = floor_div(2 * (place_q3 + seen.raw()) * c_q3 + standoff_q3_, 2 * standoff_q3_);
  return DisplacementUm::from_raw(saturate_raw<int16_t>(seen.raw() + hidden_q3, saturations));
}

void PinholeNodes::lift(NodeDisplacement& node, size_t i, int64_t c_q3, SaturationCounter& saturations) const {
  node = {sideways(node.x, place_[i].x_q3, c_q3, saturations), sideways(node.y, place_[i].y_q3, c_q3, saturations),
          DisplacementUm::from_raw(saturate_raw<int16_t>(node.z.raw() + c_q3, saturations))};
}

}  // namespace ruffini
