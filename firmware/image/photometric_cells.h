// A row of cells of photometric.h, on lanes (lanes_scalar.h). Bounds: |S| <= 16 2^15, M . S < 3 2^34 in Q24, so below
// 2^28 in Q16; 1 / n in Q20, products below 2^49. Of the table: differences of slopes below 2^16 times 2^9, rounded by
// 2^4, and once more.
#pragma once

#include <array>

#include "image/lanes_scalar.h"
#include "image/photometric.h"

namespace ruffini {

// 2^20 / n, rounded, for n pixels of a cell; 0 for none.
inline constexpr auto kInverseCount = [] {
  std::array<int32_t, 17> out{};
  for (int n = 1; n <= 16; ++n) out[static_cast<size_t>(n)] = ((2 << 20) + n) / (2 * n);
  return out;
}();

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
  static constexpr int kOne = 16'384;     // Q14
  static constexpr int kStepBits = 9;     // of q, below one step of the table: 2 16384 / 64 = 512
  static constexpr int kHalfWayBits = 4;  // of those, dropped between the two directions

  template <int kStep>
  static void both(const CellRow& row, int whole) {
    cells<L, kStep>(row, 0, whole);
    cells<ScalarLanes, kStep>(row, whole, row.n_cells);
  }

  // Sum over the pixels of each cell of values & keep.
  template <typename Some, int kStep>
  static typename Some::V sum(const int16_t* values, const int16_t* keep, ptrdiff_t width) {
    auto out = Some::same(0);
    for (int y = 0; y < kStep; ++y)
      out = Some::add(out, Some::template sum_kept<kStep>(values + y * width, keep + y * width));
    return out;
  }

  // q of one axis from the sums of three colours.
  template <typename Some>
  static typename Some::V unmixed(const typename Some::V* sums, const int16_t* m, ptrdiff_t plane,
                                  typename Some::V inverse_count) {
    auto dot = Some::mul(sums[0], Some::load_16(m));
    dot = Some::add_wide(dot, Some::mul(sums[1], Some::load_16(m + plane)));
    dot = Some::add_wide(dot, Some::mul(sums[2], Some::load_16(m + 2 * plane)));
    const auto q = Some::narrow(Some::mul(Some::narrow(dot, 8), inverse_count), 22);
    return Some::add(Some::max(Some::min(q, Some::same(kOne)), Some::same(-kOne)), Some::same(kOne));
  }

  template <typename Some>
  static typename Some::V between(typename Some::V a, typename Some::V b, typename Some::V fraction, int bits) {
    const auto scaled = Some::template left<kStepBits>(a);
    return Some::round_right(Some::add(scaled, Some::times(Some::sub(b, a), fraction)), bits);
  }

  template <typename Some, int kStep>
  static void cells(const CellRow& row, int from, int to) {
    constexpr int kLines = Photometric::kSlopeSize;
    for (int x = from; x < to; x += Some::kCount) {
      const ptrdiff_t pixel = ptrdiff_t{x} * kStep;
      typename Some::V sums[3];
      for (int c = 0; c < 3; ++c)
        sums[c] = sum<Some, kStep>(row.change + c * row.plane + pixel, row.keep + pixel, row.width);
      const auto n_kept = Some::sub(Some::same(0), sum<Some, kStep>(row.keep + pixel, row.keep + pixel, row.width));
      Some::store_16(row.n_kept + x, n_kept);
      const auto inverse = Some::look_up(kInverseCount.data(), n_kept);
      const int16_t* m = row.unmix + x;
      const auto q_x = unmixed<Some>(sums, m, row.unmix_plane, inverse);
      const auto q_y = unmixed<Some>(sums, m + 3 * row.unmix_plane, row.unmix_plane, inverse);
      const auto column = Some::min(Some::template right<kStepBits>(q_x), Some::same(kLines - 2));
      const auto line = Some::min(Some::template right<kStepBits>(q_y), Some::same(kLines - 2));
      const auto f_x = Some::sub(q_x, Some::template left<kStepBits>(column));
      const auto f_y = Some::sub(q_y, Some::template left<kStepBits>(line));
      const auto at = Some::add(Some::times(line, Some::same(kLines)), column);
      typename Some::V corner[4];
      for (int i = 0; i < 4; ++i) corner[i] = Some::look_up(row.slope + (i / 2) * kLines + i % 2, at);
      const auto bilinear = [&](auto part) {
        const auto upper = between<Some>(part(corner[0]), part(corner[1]), f_x, kHalfWayBits);
        const auto lower = between<Some>(part(corner[2]), part(corner[3]), f_x, kHalfWayBits);
        return between<Some>(upper, lower, f_y, 2 * kStepBits - kHalfWayBits);
      };
      const auto s_x =
          bilinear([](typename Some::V both) { return Some::template right<16>(Some::template left<16>(both)); });
      const auto s_y = bilinear([](typename Some::V both) { return Some::template right<16>(both); });
      const auto low = Some::bit_and(s_x, Some::same(0xFFFF));
      Some::store(row.out + x, Some::add(Some::template left<16>(s_y), low));
    }
  }
};

}  // namespace ruffini
