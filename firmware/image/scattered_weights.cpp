#include "image/scattered_weights.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr size_t kCount = MarkerWeights::kCount;
constexpr size_t kOrder = 6;
constexpr int64_t kSoftQ16 = 1'311;   // 1/50
constexpr int64_t kSlopeQ26 = 6'711;  // 1e-4
constexpr int64_t kCurvatureQ26 = 67'109;

using Vector = std::array<int64_t, kOrder>;
using Matrix = std::array<Vector, kOrder>;

struct Near {
  int marker = 0;
  int64_t apart2 = 0;
};
// The nearest markers, sorted by distance; among equals the first one comes first.
struct Nearest {
  std::array<Near, kCount + 1> item{};
  size_t n = 0;

  void add(const Near& one) {
    size_t at = n < item.size() ? n++ : n;
    while (at > 0 && item[at - 1].apart2 > one.apart2) {
      if (at < item.size()) item[at] = item[at - 1];
      --at;
    }
    if (at < item.size()) item[at] = one;
  }
};

int64_t integer_root(int64_t square) {
  int64_t root = 0;
  for (int64_t bit = int64_t{1} << 30; bit > 0; bit >>= 1) {
    if ((root + bit) * (root + bit) <= square) root += bit;
  }
  return root;
}

Vector basis_q12(int64_t x, int64_t y) { return {4'096, x, y, x * x >> 12, x * y >> 12, y * y >> 12}; }

// First column of the inverse, Q20, of a positive definite Q26 matrix.
Vector first_column_of_inverse(Matrix g) {
  Vector right{int64_t{1} << 26};
  for (size_t p = 0; p < kOrder; ++p) {
    g[p][p] = std::max(g[p][p], kSlopeQ26 / 2);  // rounding cannot reduce it further
    for (size_t i = p + 1; i < kOrder; ++i) {
      const int64_t factor = floor_div(g[i][p] << 26, g[p][p]);
      for (size_t j = p; j < kOrder; ++j) g[i][j] -= round_shift(factor * g[p][j], 26);
      right[i] -= round_shift(factor * right[p], 26);
    }
  }
  Vector out{};
  for (size_t i = kOrder; i-- > 0;) {
    int64_t rest = right[i] << 20;
    for (size_t j = i + 1; j < kOrder; ++j) rest -= g[i][j] * out[j];
    out[i] = floor_div(rest, g[i][i]);
  }
  return out;
}

}  // namespace

MarkerWeights scattered_weights(const PadPoint& place, std::span<const PadPoint> rest,
                                std::span<const Marker> markers) {
  Nearest nearest;
  for (size_t i = 0; i < rest.size(); ++i) {
    const int64_t x = rest[i].x - place.x;
    const int64_t y = rest[i].y - place.y;
    if (!markers[i].is_absent) nearest.add({static_cast<int>(i), x * x + y * y});
  }
  MarkerWeights out;
  if (nearest.n == 0) return out;
  const size_t n = nearest.n - 1;  // the last one only determines the radius
  const int64_t reach2 = std::max<int64_t>(nearest.item[n].apart2, 1);
  const int64_t reach = integer_root(reach2);
  std::array<Vector, kCount> basis{};
  std::array<int64_t, kCount> w{};
  int64_t total = 0;
  for (size_t k = 0; k < n; ++k) {
    const PadPoint& at = rest[static_cast<size_t>(nearest.item[k].marker)];
    basis[k] = basis_q12(floor_div((at.x - place.x) * 4'096, reach), floor_div((at.y - place.y) * 4'096, reach));
    const int64_t t = (nearest.item[k].apart2 << 16) / reach2;
    w[k] = (65'536 - t) * (65'536 - t) / (t + kSoftQ16) + 1;
    total += w[k];
  }
  for (size_t k = 0; k < n; ++k) w[k] = (w[k] << 26) / total;
  Matrix g{};
  for (size_t i = 0; i < kOrder; ++i) {
    for (size_t j = 0; j < kOrder; ++j) {
      for (size_t k = 0; k < n; ++k) g[i][j] += w[k] * basis[k][i] * basis[k][j];
      g[i][j] = round_shift(g[i][j], 24);
    }
    if (i > 0) g[i][i] += i < 3 ? kSlopeQ26 : kCurvatureQ26;
  }
  const Vector column = first_column_of_inverse(g);
  int64_t left = int64_t{1} << 28;
  for (size_t k = 0; k < n; ++k) {
    int64_t value = 0;
    for (size_t i = 0; i < kOrder; ++i) value += basis[k][i] * column[i];
    out.marker[k] = nearest.item[k].marker;
    out.weight_q28[k] = round_shift(w[k] * (value >> 12), 18);
    left -= out.weight_q28[k];
  }
  out.marker[0] = nearest.item[0].marker;
  out.weight_q28[0] += left;
  return out;
}

}  // namespace ruffini
