#include "image/marker_interpolation.h"

#include <algorithm>

#include "base/filled.h"
#include "image/scattered_weights.h"

namespace ruffini {

MarkerInterpolation::MarkerInterpolation(const BoardSettings& board)
    : is_scattered_(board.markers.is_scattered),
      lattice_(board.markers.lattice),
      pitch_{board.markers.pitch_x_um * 8, board.markers.pitch_y_um * 8} {
  if (lattice_.count() == 0) return;  // a board without [markers]: the stage does not run
  const MarkerSettings& m = board.markers;
  const WindowSettings& w = board.window;
  const NodeRange x = observed_nodes(board.grid.n_x, board.pad.size_x_um, w.min_x_um, w.max_x_um);
  const NodeRange y = observed_nodes(board.grid.n_y, board.pad.size_y_um, w.min_y_um, w.max_y_um);
  nodes_ = {x.count, y.count};
  // Node i of n: X = i size / (n - 1) from the pad's corner.
  const auto from_center_q3 = [](int64_t i, int64_t steps, int64_t size_um) {
    return floor_div(2 * i * size_um * 8 - size_um * steps * 8, 2 * steps);
  };
  const auto on_lattice_q16 = [](int64_t i, int64_t steps, int64_t size_um, int64_t first_um, int64_t pitch_um) {
    return floor_div((i * size_um - first_um * steps) * 65'536, pitch_um * steps);
  };
  for (int row = y.first; row < y.first + y.count; ++row) {
    for (int column = x.first; column < x.first + x.count; ++column) {
      place_.push_back({from_center_q3(column, board.grid.n_x - 1, board.pad.size_x_um),
                        from_center_q3(row, board.grid.n_y - 1, board.pad.size_y_um)});
      nominal_.push_back({on_lattice_q16(column, board.grid.n_x - 1, board.pad.size_x_um, m.first_x_um, m.pitch_x_um),
                          on_lattice_q16(row, board.grid.n_y - 1, board.pad.size_y_um, m.first_y_um, m.pitch_y_um)});
    }
  }
  weights_.resize(place_.size());
}

// Catmull-Rom weights at `position`; lines outside the lattice are extrapolated: u_-1 = 2 u_0 - u_1.
MarkerInterpolation::Taps MarkerInterpolation::taps(int64_t position_q16, int n_lines) {
  const int64_t position = std::clamp<int64_t>(position_q16, -65'536, int64_t{n_lines} * 65'536);
  const int base = static_cast<int>(std::clamp<int64_t>(position >> 16, 0, n_lines - 2));
  const int64_t t = (position - (int64_t{base} << 16)) >> 2;  // Q14, beyond [0, 1] outside
  const int64_t one = 16'384;
  Taps out;
  if (t < 0 || t > one) {
    out.line = {base, base + 1, base, base};
    out.weight = {one - t, t, 0, 0};
    return out;
  }
  const int64_t t2 = t * t >> 14;
  const int64_t t3 = t2 * t >> 14;
  const std::array<int64_t, 4> w = {(-t + 2 * t2 - t3) >> 1, (2 * one - 5 * t2 + 3 * t3) >> 1,
                                    (t + 4 * t2 - 3 * t3) >> 1, (t3 - t2) >> 1};
  out.line = {base > 0 ? base - 1 : base, base, base + 1, base + 2 < n_lines ? base + 2 : base + 1};
  out.weight = w;
  if (base == 0) {  // u_-1 = 2 u_0 - u_1
    out.weight = {0, w[1] + 2 * w[0], w[2] - w[0], w[3]};
  }
  if (base + 2 >= n_lines) {  // u_n = 2 u_n-1 - u_n-2
    out.weight[2] += 2 * w[3];
    out.weight[1] -= w[3];
    out.weight[3] = 0;
  }
  // Rounding errors go to the nearer line, so that a constant stays constant.
  out.weight[t < one / 2 ? 1 : 2] += one - (out.weight[0] + out.weight[1] + out.weight[2] + out.weight[3]);
  return out;
}

MarkerWeights MarkerInterpolation::on_lattice(int64_t a_q16, int64_t b_q16) const {
  const Taps tx = taps(a_q16, lattice_.n_x);
  const Taps ty = taps(b_q16, lattice_.n_y);
  MarkerWeights out;
  for (size_t k = 0; k < MarkerWeights::kCount; ++k) {
    out.marker[k] = ty.line[k / 4] * lattice_.n_x + tx.line[k % 4];
    out.weight_q28[k] = ty.weight[k / 4] * tx.weight[k % 4];
  }
  return out;
}

MarkerWeights MarkerInterpolation::on_lattice_of(size_t node, std::span<const PadPoint> rest) const {
  PadPoint at = nominal_[node];
  MarkerWeights weights = on_lattice(at.x, at.y);
  for (int round = 0; round < kPlaceRounds; ++round) {
    const auto miss = [&](int64_t PadPoint::* axis) {
      return place_[node].*axis - round_shift(sum(weights, [&](size_t i) { return rest[i].*axis; }), 28);
    };
    at.x += floor_div(miss(&PadPoint::x) * 65'536, pitch_.x);
    at.y += floor_div(miss(&PadPoint::y) * 65'536, pitch_.y);
    at = {std::clamp<int64_t>(at.x, -65'536, int64_t{lattice_.n_x} * 65'536),
          std::clamp<int64_t>(at.y, -65'536, int64_t{lattice_.n_y} * 65'536)};
    weights = on_lattice(at.x, at.y);
  }
  return weights;
}

void MarkerInterpolation::learn(std::span<const PadPoint> rest, std::span<const Marker> markers) {
  for (size_t node = 0; node < weights_.size(); ++node) {
    weights_[node] = is_scattered_ ? scattered_weights(place_[node], rest, markers) : on_lattice_of(node, rest);
  }
}

void MarkerInterpolation::mark_filled(std::span<const uint8_t> is_missing, std::span<uint8_t> filled) const {
  constexpr int64_t kHalf = int64_t{1} << 27;  // Q28
  std::fill(filled.begin(), filled.end(), kNothingFilled);
  if (std::all_of(is_missing.begin(), is_missing.end(), [](uint8_t m) { return m == 0; })) return;
  for (size_t node = 0; node < filled.size(); ++node) {
    const MarkerWeights& w = weights_[node];
    int64_t lost = 0;
    for (size_t k = 0; k < MarkerWeights::kCount; ++k) {
      if (is_missing[static_cast<size_t>(w.marker[k])] != 0)
        lost += w.weight_q28[k] < 0 ? -w.weight_q28[k] : w.weight_q28[k];
    }
    filled[node] = lost >= kHalf ? kShearFilled : kNothingFilled;
  }
}

}  // namespace ruffini
