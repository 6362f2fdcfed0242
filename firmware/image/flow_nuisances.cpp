#include "image/flow_nuisances.h"

#include <algorithm>
#include <bit>
#include <cstdlib>
#include <numeric>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int kShareFraction = 20;

int64_t dot(std::span<const int32_t> a, std::span<const int32_t> b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), int64_t{0}, std::plus<>(),
                            [](int32_t x, int32_t y) { return int64_t{x} * y; });
}

}  // namespace

FlowNuisances::FlowNuisances(size_t n_samples, size_t n_directions)
    : n_samples_(n_samples), all_(n_samples * n_directions), square_(n_directions) {}

int FlowNuisances::scale(std::span<int32_t> v) {
  int32_t largest = 0;
  for (const int32_t x : v) largest = std::max(largest, std::abs(x));
  const int bits = static_cast<int>(std::bit_width(static_cast<uint32_t>(largest)));
  if (bits == 0) return 0;
  for (int32_t& x : v) {
    x = bits > kBits ? x >> (bits - kBits) : static_cast<int32_t>(static_cast<uint32_t>(x) << (kBits - bits));
  }
  return bits;
}

void FlowNuisances::remove(std::span<int32_t> g) const {
  for (size_t i = 0; i < n_; ++i) {
    const std::span<const int32_t> q = direction(i);
    const int64_t share = floor_div(dot(g, q) << kShareFraction, square_[i]);
    std::transform(g.begin(), g.end(), q.begin(), g.begin(), [&](int32_t x, int32_t along) {
      return x - static_cast<int32_t>(round_shift(share * along, kShareFraction));
    });
  }
}

void FlowNuisances::add(std::span<int32_t> v) {
  if (scale(v) == 0) return;
  remove(v);
  if (scale(v) < kMinBits) return;
  remove(v);
  std::copy(v.begin(), v.end(), all_.begin() + static_cast<ptrdiff_t>(n_ * n_samples_));
  square_[n_] = dot(v, v);
  ++n_;
}

}  // namespace ruffini
