// One row of the weights of dots.h, on lanes (lanes_scalar.h). Bounds: the sum of a box is below 2^31
// (kMaxBoxRadiusPx), its inverse below 2^29 (a box has at least 3 x 3 pixels), background and grey are at most 12,240,
// the threshold is below 2^16.
#pragma once

#include <algorithm>

#include "image/dots.h"
#include "image/lanes_scalar.h"

namespace ruffini {

template <typename L>
class DotWeights {
 public:
  static void run(const DotRow& row) {
    const int whole = row.width / L::kCount * L::kCount;
    move<L>(row, 0, whole);
    move<ScalarLanes>(row, whole, row.width);
    add_up(row, 0, 0);
    weigh<L>(row, 0, whole);
    weigh<ScalarLanes>(row, whole, row.width);
  }

  // What remains of a row when another version (dot_weights_neon.h) has done the pixels before `from`, whose columns
  // add up to `sum`.
  static void finish(const DotRow& row, int from, uint32_t sum) {
    move<L>(row, from, row.width);
    add_up(row, from, sum);
  }
  static void finish_weights(const DotRow& row, int from) { weigh<L>(row, from, row.width); }

 private:
  static void add_up(const DotRow& row, int from, uint32_t sum) {
    int32_t* sums = row.prefix_sum + row.box_radius_px + 1;
    for (int x = from; x < row.width; ++x) {
      sum += static_cast<uint32_t>(row.column_sum[x]);  // may wrap at 32 bits; differences stay exact
      sums[x] = static_cast<int32_t>(sum);
    }
    std::fill_n(sums + row.width, row.box_radius_px, static_cast<int32_t>(sum));
  }

  template <typename Some>
  static typename Some::V level(const uint16_t* grey) {
    return Some::load_16(reinterpret_cast<const int16_t*>(grey));
  }

  template <typename Some>
  static void move(const DotRow& row, int from, int to) {
    for (int x = from; x < to; x += Some::kCount) {
      const auto moved = Some::sub(level<Some>(row.entering + x), level<Some>(row.leaving + x));
      Some::store(row.column_sum + x, Some::add(Some::load(row.column_sum + x), moved));
    }
  }

  template <typename Some>
  static void weigh(const DotRow& row, int from, int to) {
    const int32_t* high = row.prefix_sum + 2 * row.box_radius_px + 1;
    for (int x = from; x < to; x += Some::kCount) {
      const auto box = Some::sub(Some::load(high + x), Some::load(row.prefix_sum + x));
      const auto background = Some::narrow(Some::mul(box, Some::load(row.inverse_q32 + x)), 32);
      const auto threshold =
          Some::template shift_right<15>(Some::mul_low(background, Some::broadcast(row.threshold_q15)));
      const auto darker = Some::sub(background, level<Some>(row.grey + x));
      const auto v = row.is_light ? Some::sub(Some::broadcast(0), darker) : darker;
      Some::store_16(row.weight + x, Some::max(Some::sub(v, threshold), Some::broadcast(0)));
    }
  }
};

}  // namespace ruffini
