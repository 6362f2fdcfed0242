#include "image/slipped_rows.h"

#include <algorithm>
#include <array>

namespace ruffini {
namespace {

constexpr int64_t kMinQ16 = 26'214;      // 0.4 px
constexpr int64_t kOfPatchQ16 = 13'107;  // 0.2 px
constexpr int64_t kPitches = 32;
constexpr int kMinRows = 4;
constexpr int kOneOf = 10;  // one column of ten may differ

}  // namespace

bool has_slipped_rows(std::span<const Marker> markers, GridSize size, RowsOf what) {
  const int s = what == RowsOf::kPatches ? 2 : 1;
  if (size.n_y < kMinRows * s || size.n_x < 2) return false;
  const auto at = [&](int i, int j) -> const Marker& { return markers[static_cast<size_t>(j * size.n_x + i)]; };
  const auto is_known = [&](int i, int j) { return !at(i, j).is_lost && !at(i, j).is_absent; };
  const int64_t height_q16 = int64_t{at(0, size.n_y - 1).rest_y.raw()} - at(0, 0).rest_y.raw();
  const int64_t limit_q16 =
      what == RowsOf::kPatches ? kOfPatchQ16 : std::max(kMinQ16, height_q16 / (size.n_y - 1) / kPitches);
  using Jump = std::array<int64_t, 2>;  // along x, y
  const auto jump = [&](int i, int row) -> Jump {
    const Marker& from = at(i, row);
    const Marker& to = at(i, row + s);
    return {int64_t{to.displacement_x.raw()} - from.displacement_x.raw(),
            int64_t{to.displacement_y.raw()} - from.displacement_y.raw()};
  };
  const auto is_slipped = [&](int j) {
    int n_known = 0;
    std::array<int, 2> n_more{};
    std::array<int, 2> n_less{};
    const auto most = [&](size_t axis) { return std::max(n_more[axis], n_less[axis]); };
    for (int i = 0; i < size.n_x; ++i) {
      if (!is_known(i, j) || !is_known(i, j + s)) continue;
      Jump beside{};  // times n_beside
      int64_t n_beside = 0;
      for (const int row : {j - s, j + s}) {
        if (row < 0 || row + s >= size.n_y || !is_known(i, row) || !is_known(i, row + s)) continue;
        const Jump other = jump(i, row);
        beside = {beside[0] + other[0], beside[1] + other[1]};
        ++n_beside;
      }
      if (n_beside == 0) continue;
      ++n_known;
      const Jump here = jump(i, j);
      for (size_t axis = 0; axis < here.size(); ++axis) {
        const int64_t bend = n_beside * here[axis] - beside[axis];
        n_more[axis] += bend > n_beside * limit_q16 ? 1 : 0;
        n_less[axis] += bend < -n_beside * limit_q16 ? 1 : 0;
      }
      // More columns differ already than allowed
      if (kOneOf * (n_known - std::max(most(0), most(1))) > size.n_x) return false;
    }
    return 2 * n_known >= size.n_x && kOneOf * std::max(most(0), most(1)) >= (kOneOf - 1) * n_known;
  };
  for (int j = 0; j < size.n_y && what == RowsOf::kPatches; ++j) {
    int n_lost = 0;
    int n_there = 0;
    // As soon as more are known than a lost row may have, the row is not lost.
    for (int i = 0; i < size.n_x && kOneOf * (n_there - n_lost) <= size.n_x; ++i) {
      n_there += at(i, j).is_absent ? 0 : 1;
      n_lost += is_known(i, j) || at(i, j).is_absent ? 0 : 1;
    }
    if (2 * n_there >= size.n_x && kOneOf * n_lost >= (kOneOf - 1) * n_there) return true;
  }
  for (int j = 0; j + s < size.n_y; ++j) {
    if (is_slipped(j)) return true;
  }
  return false;
}

}  // namespace ruffini
