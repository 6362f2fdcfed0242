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
    const int whole = L::kCount > 1 ? row.width / L::kCount * L::kCount : 0;
    finish(row, whole, add_up_lanes(row, whole));
    for (int x = 0, tile = 0; x < row.width; x += DotTiles::kSide, ++tile) {
      x + DotTiles::kSide <= row.width ? weigh<L>(row, tile, x, x + DotTiles::kSide)
                                       : weigh<ScalarLanes>(row, tile, x, row.width);
    }
  }

  // What remains of a row when another version (dot_weights_neon.h) has done the pixels before `from`, whose columns
  // add up to `sum`.
  static void finish(const DotRow& row, int from, uint32_t sum) {
    move(row, from);
    add_up(row, from, sum);
  }
  static void finish_weights(const DotRow& row, int from) {
    if (from < row.width) weigh<ScalarLanes>(row, from / DotTiles::kSide, from, row.width);
  }

 private:
  // Moves the boxes by a row and adds up their columns before `whole`. Returns the sum of all.
  static uint32_t add_up_lanes(const DotRow& given, int whole) {
    if constexpr (L::kCount > 1) {
      const DotRow row = given;  // a copy that no store can change stays in registers
      int32_t* const sums = row.prefix_sum + row.box_radius_px + 1;
      auto so_far = L::broadcast(0);
      for (int x = 0; x < whole; x += L::kCount) {
        const auto moved = L::sub(level<L>(row.entering + x), level<L>(row.leaving + x));
        const auto column = L::add(L::load(row.column_sum + x), moved);
        L::store(row.column_sum + x, column);
        const auto within = L::prefix_sums(column);
        L::store(sums + x, L::add(within, so_far));
        so_far = L::add(so_far, L::broadcast_last(within));
      }
      return static_cast<uint32_t>(L::first(so_far));
    }
    return 0;
  }

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

  static void move(const DotRow& row, int from) {
    for (int x = from; x < row.width; ++x) row.column_sum[x] += row.entering[x] - row.leaving[x];
  }

  template <typename Some>
  static void weigh(const DotRow& row, int tile, int from, int to) {
    if (row.open[tile] == 0) {
      std::fill(row.weight + from, row.weight + to, int16_t{0});
      return;
    }
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
