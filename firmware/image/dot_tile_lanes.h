// Kernels of dot_tiles.h on lanes (lanes_scalar.h). Grey is at most 12,240, so it loads as a signed number.
#pragma once

#include <algorithm>

#include "image/dot_tiles.h"
#include "image/lanes_scalar.h"

namespace ruffini {

template <typename L>
class DotTileLanes {
 public:
  static constexpr TileKernels kernels() noexcept { return {measure, widen, bound, add, add_grey}; }

 private:
  static void measure(const TileRow& given) {
    const TileRow row = given;  // a copy that no store can change stays in registers
    for (int x = 0, tile = 0; x < row.width; x += DotTiles::kSide, ++tile) {
      x + DotTiles::kSide <= row.width ? measure_one<L>(row, tile, x, x + DotTiles::kSide)
                                       : measure_one<ScalarLanes>(row, tile, x, row.width);
    }
  }

  template <typename Some>
  static void measure_one(const TileRow& row, int tile, int from, int to) {
    using V = typename Some::V;
    const auto grey = [&](int x, int y) {
      return Some::load_16(reinterpret_cast<const int16_t*>(row.grey + ptrdiff_t{y} * row.width + x));
    };
    V least = grey(from, 0);
    V most = least;
    V sum = Some::broadcast(0);
    for (int x = from; x < to; x += Some::kCount) {
      V column = Some::broadcast(0);
      for (int y = 0; y < row.n_rows; ++y) {
        const V level = grey(x, y);
        least = Some::min(least, level);
        most = Some::max(most, level);
        column = Some::add(column, level);
      }
      Some::store(row.column_sum + x, column);
      sum = Some::add(sum, column);
    }
    const int32_t darkest = -Some::max_lane(Some::sub(Some::broadcast(0), least));
    const int32_t lightest = Some::max_lane(most);
    row.min_grey[tile] = row.is_light ? -lightest : darkest;
    row.max_grey[tile] = row.is_light ? -darkest : lightest;
    row.sum[tile] = static_cast<int32_t>(Some::sum(sum));
  }

  // In lanes, then those that remain one by one: one(Some, i).
  template <typename One>
  static void each(int n, One one) {
    const int whole = n / L::kCount * L::kCount;
    for (int i = 0; i < whole; i += L::kCount) one(L(), i);
    for (int i = whole; i < n; ++i) one(ScalarLanes(), i);
  }

  static void widen(int32_t* values, int n, int by) {
    each(n, [=](auto some, int i) {
      using Some = decltype(some);
      Some::store(values + i, Some::max(Some::load(values + i), Some::load(values + i + by)));
    });
  }

  static void bound(const TileBounds& given) {
    const TileBounds row = given;
    each(row.n_tiles, [&row](auto some, int i) {
      using Some = decltype(some);
      const auto zero = Some::broadcast(0);
      const auto high = Some::sub(Some::load(row.high_right + i), Some::load(row.high_left + i));
      const auto low = Some::sub(Some::load(row.low_right + i), Some::load(row.low_left + i));
      const auto grey = Some::sub(high, low);
      const auto inside = Some::mul_low(Some::load(row.n_columns + i), Some::broadcast(row.n_rows));
      const auto outside = Some::sub(Some::broadcast(row.area), inside);
      const auto sum = Some::add(row.is_light ? Some::sub(zero, grey) : grey,
                                 Some::mul_low(outside, Some::load(row.max_grey_in_boxes + i)));
      // Background and bound each err by less than 1/4 (inverse) + 1/2 (rounding), so the integers differ by at most 1.
      const auto mean = Some::narrow(Some::mul(sum, Some::broadcast(row.inverse_q32)), 32);
      const auto bound = Some::add(mean, Some::broadcast(1));
      const auto background = row.is_light ? Some::sub(zero, bound) : bound;
      const auto threshold =
          Some::template shift_right<15>(Some::mul_low(background, Some::broadcast(row.threshold_q15)));
      const auto weight = Some::sub(Some::sub(bound, Some::load(row.min_grey + i)), threshold);
      Some::store_16(row.open + i, Some::max(weight, zero));
    });
  }

  static void add(int32_t* sums, const int32_t* values, int n) {
    each(n, [=](auto some, int i) {
      using Some = decltype(some);
      Some::store(sums + i, Some::add(Some::load(sums + i), Some::load(values + i)));
    });
  }
  static void add_grey(int32_t* sums, const uint16_t* grey, int n) {
    each(n, [=](auto some, int i) {
      using Some = decltype(some);
      const auto level = Some::load_16(reinterpret_cast<const int16_t*>(grey + i));
      Some::store(sums + i, Some::add(Some::load(sums + i), level));
    });
  }
};

}  // namespace ruffini
