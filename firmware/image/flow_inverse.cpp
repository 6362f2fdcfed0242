#include "image/flow_inverse.h"

#include <algorithm>
#include <bit>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int64_t kMaxInverse = 1 << 30;  // K times a sum of 2^31, twice, stays below 2^62
constexpr int kBits = 33;                 // of the determinant

}  // namespace

FlowInverse invert_flow(const std::array<int64_t, 4>& a, int64_t least) {
  const auto [xx, xy, yx, yy] = a;
  const int64_t det = xx * yy - xy * yx;
  if (xx <= 0 || yy <= 0 || det <= 0 || det / (xx + yy) < least) return {};
  const int b = std::max(static_cast<int>(std::bit_width(static_cast<uint64_t>(det))) - kBits, 0);
  const std::array<int64_t, 4> entry = {yy, -xy, -yx, xx};
  FlowInverse out;
  for (size_t i = 0; i < entry.size(); ++i) {
    const int64_t k = floor_div(entry[i] * (int64_t{1} << kBits), det >> b);
    if (k >= kMaxInverse || k <= -kMaxInverse) return {};
    out.k[i] = static_cast<int32_t>(k);
  }
  out.shift = kBits + b - 16;
  return out;
}

}  // namespace ruffini
