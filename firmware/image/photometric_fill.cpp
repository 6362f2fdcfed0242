#include "image/photometric_fill.h"

#include <cstring>

namespace ruffini {
namespace {

// True if one of four numbers, none of them negative, is zero: the lowest zero is the first from which a one is
// borrowed.
bool has_zero(const int16_t* numbers) {
  constexpr uint64_t kOnes = 0x0001'0001'0001'0001;
  uint64_t four;
  std::memcpy(&four, numbers, sizeof four);
  return ((four - kOnes) & ~four & (kOnes << 15)) != 0;
}

}  // namespace

PhotometricFill::PhotometricFill(GridSize grid) : grid_(grid) {
  const auto n = static_cast<size_t>(grid.count());
  empty_.reserve(n);
  for (std::vector<uint16_t>& distance : distance_) distance.resize(n);
}

void PhotometricFill::run(std::span<const int16_t> n_kept, std::span<CellSlope> slope) {
  constexpr int32_t kWeight = 4096;
  const auto n_x = static_cast<size_t>(grid_.n_x);
  empty_.clear();
  for (size_t i = 0; i < n_kept.size(); ++i) {
    while (i + 4 <= n_kept.size() && !has_zero(&n_kept[i])) i += 4;  // most cells are unmasked
    if (i < n_kept.size() && n_kept[i] == 0) empty_.push_back(static_cast<uint32_t>(i));
  }
  // One more than the neighbour's distance, if that one is masked too.
  const auto reach = [&](Direction direction, size_t at, bool is_inside, size_t neighbour) {
    uint16_t& d = distance_[direction][at];
    d = is_inside ? 1 : 0;
    if (!is_inside || n_kept[neighbour] != 0) return;
    const uint16_t beyond = distance_[direction][neighbour];
    d = beyond == 0 ? uint16_t{0} : static_cast<uint16_t>(beyond + 1);
  };
  for (const uint32_t at : empty_) {
    reach(kLeft, at, at % n_x != 0, at - size_t{1});
    reach(kAbove, at, at >= n_x, at - n_x);
  }
  for (size_t i = empty_.size(); i-- > 0;) {
    const size_t at = empty_[i];
    reach(kRight, at, (at + 1) % n_x != 0, at + 1);
    reach(kBelow, at, at + n_x < n_kept.size(), at + n_x);
  }
  for (const uint32_t at : empty_) {
    int32_t sum_x = 0;
    int32_t sum_y = 0;
    int32_t total = 0;
    const auto take = [&](Direction direction, int64_t one) {
      const int32_t d = distance_[direction][at];
      if (d == 0) return;
      const CellSlope& there = slope[static_cast<size_t>(at + d * one)];
      const int32_t weight = kWeight / d;
      sum_x += weight * there.x.raw();
      sum_y += weight * there.y.raw();
      total += weight;
    };
    take(kLeft, -1);
    take(kAbove, -static_cast<int64_t>(n_x));
    take(kRight, 1);
    take(kBelow, static_cast<int64_t>(n_x));
    const auto mean = [&](int32_t sum) {
      return Slope::from_raw(
          total == 0 ? int16_t{0} : static_cast<int16_t>(floor_div(2 * int64_t{sum} + total, 2 * int64_t{total})));
    };
    slope[at] = {mean(sum_x), mean(sum_y)};
  }
}

}  // namespace ruffini
