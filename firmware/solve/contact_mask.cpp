#include "solve/contact_mask.h"

#include <algorithm>
#include <iterator>
#include <limits>

namespace ruffini {
namespace {

constexpr int kStrongestShift = 3;  // T is at least an eighth of the strongest force
constexpr int32_t kMaxNoiseUn = 100'000'000;
constexpr int64_t kMaxPressure = std::numeric_limits<int32_t>::max();
constexpr int64_t kPressedShare = 4;
constexpr int kSmallestSide = 2;
constexpr int kLargestSide = 8;

// Excess over a threshold: 0 at the threshold to kFull at twice the threshold, rounded up.
uint8_t surely(int64_t pressure, int64_t threshold) {
  const int64_t beyond = std::clamp<int64_t>(pressure - threshold, 0, threshold);
  return static_cast<uint8_t>((beyond * ContactMask::kFull + threshold - 1) / threshold);
}

// Divisor of the board's threshold if the noise is unknown.
int64_t least_share(int side) { return int64_t{side} * side / 4; }

void raise(uint8_t& value, uint8_t to) { value = std::max(value, to); }

// Minimum of each value and those `step` to its right, below, and diagonal. A square that leaves the grid has 0.
void shrink(std::span<int32_t> values, GridSize size, int step) {
  const auto n_x = static_cast<size_t>(size.n_x);
  const auto ahead = static_cast<size_t>(step);
  for (size_t row = 0; row < values.size(); row += n_x) {
    for (size_t x = 0; x + ahead < n_x; ++x) values[row + x] = std::min(values[row + x], values[row + x + ahead]);
    std::fill_n(&values[row + n_x - std::min(ahead, n_x)], std::min(ahead, n_x), 0);
  }
  const size_t below = std::min(ahead * n_x, values.size());
  for (size_t i = 0; i + below < values.size(); ++i) values[i] = std::min(values[i], values[i + below]);
  std::fill(values.end() - static_cast<ptrdiff_t>(below), values.end(), 0);
}

// Maximum of each value and those `step` to its left, above, and diagonal.
void grow(std::span<int32_t> values, GridSize size, int step) {
  const auto n_x = static_cast<size_t>(size.n_x);
  const auto behind = static_cast<size_t>(step);
  for (size_t row = 0; row < values.size(); row += n_x) {
    for (size_t x = n_x; x-- > behind;) values[row + x] = std::max(values[row + x], values[row + x - behind]);
  }
  for (size_t i = values.size(); i-- > behind * n_x;) values[i] = std::max(values[i], values[i - behind * n_x]);
}

}  // namespace

ContactMask::ContactMask(GridSize nodes, int64_t threshold_lsb, int64_t min_nodes)
    : nodes_(nodes),
      threshold_lsb_(threshold_lsb),
      min_nodes_(min_nodes),
      frame_threshold_lsb_(threshold_lsb),
      smallest_(static_cast<size_t>(nodes.count())),
      largest_(smallest_.size()),
      opened_(smallest_.size()),
      mask_(smallest_.size()) {}

int64_t ContactMask::threshold_of(int side, int64_t strongest_lsb, bool is_steady) const {
  const int64_t least = noise_lsb_.value_or(std::max<int64_t>(threshold_lsb_ / least_share(side), 1));
  const int64_t wanted = is_steady ? strongest_lsb >> kStrongestShift : threshold_lsb_;
  return std::max(least, std::min(threshold_lsb_, wanted));
}

// Precondition: smallest_ belongs to squares of this side.
void ContactMask::open(int side, int64_t threshold) {
  if (*std::max_element(smallest_.begin(), smallest_.end()) <= threshold) return;
  std::copy(smallest_.begin(), smallest_.end(), largest_.begin());
  for (int step = 1; step < side; step *= 2) grow(largest_, nodes_, step);
  for (size_t i = 0; i < opened_.size(); ++i) {
    if (largest_[i] > threshold) raise(opened_[i], surely(largest_[i], threshold));
  }
}

std::span<const uint8_t> ContactMask::find(std::span<const NodeForce> force, bool is_steady) {
  std::fill(opened_.begin(), opened_.end(), uint8_t{0});
  std::fill(mask_.begin(), mask_.end(), uint8_t{0});
  const auto strongest =
      std::min_element(force.begin(), force.end(), [](const NodeForce& a, const NodeForce& b) { return a.z < b.z; });
  const int64_t strongest_lsb = -int64_t{strongest->z};
  std::transform(force.begin(), force.end(), smallest_.begin(), [](const NodeForce& f) {
    return static_cast<int32_t>(std::clamp<int64_t>(-int64_t{f.z}, 0, kMaxPressure));
  });
  const int64_t usual = threshold_of(kSmallestSide, strongest_lsb, is_steady);
  frame_threshold_lsb_ = threshold_of(kLargestSide, strongest_lsb, is_steady);
  is_pressed_ = strongest_lsb > threshold_lsb_ / kPressedShare;
  for (int side = kSmallestSide; side <= kLargestSide; side *= 2) {
    const int64_t threshold = threshold_of(side, strongest_lsb, is_steady);
    if (side > kSmallestSide && threshold == usual) break;  // larger squares cannot open further nodes
    shrink(smallest_, nodes_, side / 2);
    open(side, threshold);
  }
  if (std::ssize(opened_) - std::count(opened_.begin(), opened_.end(), uint8_t{0}) < min_nodes_) {
    std::fill(opened_.begin(), opened_.end(), uint8_t{0});
  }
  raise(opened_[static_cast<size_t>(strongest - force.begin())],
        is_steady ? surely(strongest_lsb, alone_lsb_) : uint8_t{0});
  for (int y = 0; y < nodes_.n_y; ++y) {
    for (int x = 0; x < nodes_.n_x; ++x) {
      const uint8_t opened = opened_[static_cast<size_t>(y * nodes_.n_x + x)];
      if (opened == 0) continue;
      for (int v = std::max(y - 1, 0); v <= std::min(y + 1, nodes_.n_y - 1); ++v) {
        for (int u = std::max(x - 1, 0); u <= std::min(x + 1, nodes_.n_x - 1); ++u) {
          raise(mask_[static_cast<size_t>(v * nodes_.n_x + u)], opened);
        }
      }
    }
  }
  return mask_;
}

Status ContactMask::load_noise(const Calibration& calibration, int64_t force_lsb_un) {
  const auto found = calibration.tensor("contact.noise_un", Tensor::Type::kI32, {2});
  if (!found) return found.error();
  const auto noise_un = found.value()->as<int32_t>();
  if (std::any_of(noise_un.begin(), noise_un.end(), [](int32_t v) { return v < 1 || v > kMaxNoiseUn; })) {
    return Error{ErrorKind::kBadInput,
                 "calibration file: contact.noise_un is not from 1 to 100000000 uN: make it again with `ruffini cal "
                 "contact`"};
  }
  noise_lsb_ = std::max<int64_t>(noise_un[0] / force_lsb_un, 1);
  alone_lsb_ = std::max<int64_t>(noise_un[1] / force_lsb_un, 1);
  return Unit{};
}

}  // namespace ruffini
