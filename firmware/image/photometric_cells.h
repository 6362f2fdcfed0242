// A row of cells of photometric.h, on lanes (lanes_scalar.h). Bounds:
//
//   d'      |S| <= n 2^15, times 2^20 / (n (1 + m)) with 1 + m >= 3/4: product below 2^35.5, d' below 2^19.6
//   q       |M| <= 2^15: three products below 2^36.1 in Q28, 2^22.1 in Q14; the bend adds at most 2^15
#pragma once

#include "image/photometric_bend.h"

namespace ruffini {

template <typename L>
class PhotometricCells {
 public:
  static void run(const CellRow& row) {
    const int whole = row.n_cells / L::kCount * L::kCount;
    switch (row.step_px) {
      case 1:
        return both<1>(row, whole);
      case 2:
        return both<2>(row, whole);
      case 3:
        return both<3>(row, whole);
      default:
        return both<4>(row, whole);
    }
  }

 private:
  static constexpr int kOne = 16'384;  // Q14

  template <int kStep>
  static void both(const CellRow& row, int whole) {
    cells<L, kStep>(row, 0, whole);
    cells<ScalarLanes, kStep>(row, whole, row.n_cells);
  }

  // Sum over the pixels of each cell of values & keep.
  template <typename Some, int kStep>
  static typename Some::V sum(const int16_t* values, const int16_t* keep, ptrdiff_t width) {
    auto out = Some::broadcast(0);
    for (int y = 0; y < kStep; ++y)
      out = Some::add(out, Some::template masked_sum<kStep>(values + y * width, keep + y * width));
    return out;
  }

  // Computes d' of the three colours from their sums. No lookup is needed if no pixel in any lane's cell is masked.
  template <typename Some, int kStep>
  static void changes(const CellRow& row, const typename Some::V* sums, typename Some::V n_kept, typename Some::V* d) {
    constexpr int kFull = kStep * kStep;
    const bool is_whole = Some::max_lane(Some::sub(Some::broadcast(kFull), n_kept)) == 0;
    for (size_t c = 0; c < 3; ++c) {
      const auto& per_count = row.per_count[c];
      const auto share = is_whole ? Some::broadcast(per_count[kFull]) : Some::gather(per_count.data(), n_kept);
      d[c] = Some::sub(Some::template narrow<16>(Some::mul(sums[c], share)), Some::broadcast(row.level_q16[c]));
    }
  }

  // M . d' of one axis, Q14.
  template <typename Some>
  static typename Some::V unmixed(const typename Some::V* d, const int16_t* m, ptrdiff_t plane) {
    auto dot = Some::mul(d[0], Some::load_16(m));
    dot = Some::add_wide(dot, Some::mul(d[1], Some::load_16(m + plane)));
    dot = Some::add_wide(dot, Some::mul(d[2], Some::load_16(m + 2 * plane)));
    return Some::template narrow<14>(dot);
  }

  // Clamps to +-1 and offsets by +1.
  template <typename Some>
  static typename Some::V from_limit(typename Some::V q) {
    return Some::add(Some::max(Some::min(q, Some::broadcast(kOne)), Some::broadcast(-kOne)), Some::broadcast(kOne));
  }

  template <typename Some, int kStep>
  static void cells(const CellRow& of_caller, int from, int to) {
    const CellRow row = of_caller;  // a copy that no store can change stays in registers
    using Table = PackedTable<L, Some>;
    constexpr int kLines = Photometric::kSlopeSize;
    for (int x = from; x < to; x += Some::kCount) {
      const ptrdiff_t pixel = ptrdiff_t{x} * kStep;
      typename Some::V sums[3];
      for (int c = 0; c < 3; ++c)
        sums[c] = sum<Some, kStep>(row.change + c * row.plane + pixel, row.keep + pixel, row.width);
      const auto n_kept =
          Some::sub(Some::broadcast(0), sum<Some, kStep>(row.keep + pixel, row.keep + pixel, row.width));
      Some::store_16(row.n_kept + x, n_kept);
      typename Some::V d[3];
      changes<Some, kStep>(row, sums, n_kept, d);
      const int16_t* m = row.unmix + x;
      typename Some::V q[2] = {unmixed<Some>(d, m, row.unmix_plane),
                               unmixed<Some>(d, m + 3 * row.unmix_plane, row.unmix_plane)};
      if (row.bend != nullptr) Table::bend(row, d, q);
      const auto q_x = from_limit<Some>(q[0]);
      const auto q_y = from_limit<Some>(q[1]);
      const auto column = Some::min(Some::template shift_right<Table::kStepBits>(q_x), Some::broadcast(kLines - 2));
      const auto line = Some::min(Some::template shift_right<Table::kStepBits>(q_y), Some::broadcast(kLines - 2));
      const auto f_x = Some::sub(q_x, Some::template shift_left<Table::kStepBits>(column));
      const auto f_y = Some::sub(q_y, Some::template shift_left<Table::kStepBits>(line));
      const auto at = Some::add(Some::mul_low(line, Some::broadcast(kLines)), column);
      typename Some::V corner[4];
      Some::gather_pair(row.slope, at, corner[0], corner[1]);
      Some::gather_pair(row.slope + kLines, at, corner[2], corner[3]);
      const auto bilinear = [&](auto part) {
        const auto upper = Table::between(part(corner[0]), part(corner[1]), f_x, Table::kHalfWayBits);
        const auto lower = Table::between(part(corner[2]), part(corner[3]), f_x, Table::kHalfWayBits);
        return Table::between(upper, lower, f_y, 2 * Table::kStepBits - Table::kHalfWayBits);
      };
      const auto s_x = Some::bit_and(bilinear(Table::x_of), Some::broadcast(0xFFFF));
      Some::store(row.out + x, Some::add(Some::template shift_left<16>(bilinear(Table::y_of)), s_x));
    }
  }
};

}  // namespace ruffini
