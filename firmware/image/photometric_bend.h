// Table lookups on lanes (lanes_scalar.h) for photometric_cells.h: interpolation of packed pairs, and N of
// photometric.h. Bounds: differences below 2^16 times 2^9, rounded by 2^4; then twice times 2^9 (sums modulo 2^32,
// results fit).
#pragma once

#include "image/lanes_scalar.h"
#include "image/photometric.h"

namespace ruffini {

// File: the lanes that the file is compiled for; `L` may be the scalar lanes for the rest of a row. Without this
// parameter the linker would merge the instantiations of all files, and a processor without AVX2 could get AVX2 code.
template <typename File, typename L>
class PackedTable {
 public:
  using V = typename L::V;
  static constexpr int kStepBits = 9;     // between two lines
  static constexpr int kHalfWayBits = 4;  // of those, dropped by the first of several interpolations

  // x is in the low half, y in the high half.
  static V x_of(V both) { return L::template shift_right<16>(L::template shift_left<16>(both)); }
  static V y_of(V both) { return L::template shift_right<16>(both); }

  // (a (2^9 - fraction) + b fraction) / 2^bits, half up.
  static V between(V a, V b, V fraction, int bits) {
    const V scaled = L::template shift_left<kStepBits>(a);
    return L::round_shift_right(L::add(scaled, L::mul_low(L::sub(b, a), fraction)), bits);
  }

  // Adds N(d') to q.
  static void bend(const CellRow& row, const V* d, V* q) {
    constexpr int kLines = Photometric::kBendSize;
    V at = L::broadcast(0);
    V fraction[3];
    for (size_t c = 0; c < 3; ++c) {
      const V from_low = L::round_shift_right(L::sub(d[c], L::broadcast(row.bend_low_q16[c])), row.bend_shift[c]);
      const V t = L::max(L::min(from_low, L::broadcast((kLines - 1) << kStepBits)), L::broadcast(0));
      const V line = L::min(L::template shift_right<kStepBits>(t), L::broadcast(kLines - 2));
      fraction[c] = L::sub(t, L::template shift_left<kStepBits>(line));
      at = L::add(L::mul_low(at, L::broadcast(kLines)), line);
    }
    V corner[8];
    for (int i = 0; i < 8; ++i) corner[i] = L::gather(row.bend + (i / 4 * kLines + i / 2 % 2) * kLines + i % 2, at);
    const auto trilinear = [&](auto part) {
      V plane[2];
      for (int i = 0; i < 2; ++i) {
        const V* edge = corner + ptrdiff_t{4} * i;
        const V upper = between(part(edge[0]), part(edge[1]), fraction[2], kHalfWayBits);
        const V lower = between(part(edge[2]), part(edge[3]), fraction[2], kHalfWayBits);
        plane[i] = between(upper, lower, fraction[1], kStepBits);
      }
      return between(plane[0], plane[1], fraction[0], 2 * kStepBits - kHalfWayBits);
    };
    q[0] = L::add(q[0], trilinear(x_of));
    q[1] = L::add(q[1], trilinear(y_of));
  }
};

}  // namespace ruffini
