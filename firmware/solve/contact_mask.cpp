#include "solve/contact_mask.h"

#include <algorithm>
#include <iterator>

namespace ruffini {
namespace {

constexpr int kStrongestShift = 3;  // T is an eighth of the strongest
constexpr int32_t kMaxNoiseUn = 100'000'000;

// How far beyond a threshold, 0 to kFull at twice the threshold, rounded up.
uint8_t surely(int64_t pressure, int64_t threshold) {
  const int64_t beyond = std::clamp<int64_t>(pressure - threshold, 0, threshold);
  return static_cast<uint8_t>((beyond * ContactMask::kFull + threshold - 1) / threshold);
}

}  // namespace

ContactMask::ContactMask(GridSize nodes, int64_t threshold_lsb, int64_t min_nodes)
    : nodes_(nodes),
      threshold_lsb_(threshold_lsb),
      min_nodes_(min_nodes),
      least_lsb_(threshold_lsb),
      frame_threshold_lsb_(threshold_lsb),
      pressed_(static_cast<size_t>(nodes.count())),
      opened_(static_cast<size_t>(nodes.count())),
      mask_(static_cast<size_t>(nodes.count())) {}

std::span<const uint8_t> ContactMask::find(std::span<const NodeForce> force, bool is_steady) {
  std::fill(opened_.begin(), opened_.end(), uint8_t{0});
  std::fill(mask_.begin(), mask_.end(), uint8_t{0});
  const auto strongest =
      std::min_element(force.begin(), force.end(), [](const NodeForce& a, const NodeForce& b) { return a.z < b.z; });
  const int64_t strongest_lsb = -int64_t{strongest->z};
  const int64_t wanted = is_steady ? strongest_lsb >> kStrongestShift : threshold_lsb_;
  frame_threshold_lsb_ = std::max(least_lsb_, std::min(threshold_lsb_, wanted));
  std::transform(force.begin(), force.end(), pressed_.begin(),
                 [&](const NodeForce& f) { return surely(-int64_t{f.z}, frame_threshold_lsb_); });
  const auto at = [&](int x, int y) { return static_cast<size_t>(y * nodes_.n_x + x); };
  const auto raise = [](uint8_t& value, uint8_t to) { value = std::max(value, to); };
  for (int y = 0; y + 1 < nodes_.n_y; ++y) {
    for (int x = 0; x + 1 < nodes_.n_x; ++x) {
      const uint8_t smallest =
          std::min({pressed_[at(x, y)], pressed_[at(x + 1, y)], pressed_[at(x, y + 1)], pressed_[at(x + 1, y + 1)]});
      for (const size_t i : {at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)}) raise(opened_[i], smallest);
    }
  }
  if (std::ssize(opened_) - std::count(opened_.begin(), opened_.end(), uint8_t{0}) < min_nodes_) {
    std::fill(opened_.begin(), opened_.end(), uint8_t{0});
  }
  raise(opened_[static_cast<size_t>(strongest - force.begin())],
        is_steady ? surely(strongest_lsb, alone_lsb_) : uint8_t{0});
  for (int y = 0; y < nodes_.n_y; ++y) {
    for (int x = 0; x < nodes_.n_x; ++x) {
      if (opened_[at(x, y)] == 0) continue;
      for (int v = std::max(y - 1, 0); v <= std::min(y + 1, nodes_.n_y - 1); ++v) {
        for (int u = std::max(x - 1, 0); u <= std::min(x + 1, nodes_.n_x - 1); ++u) {
          raise(mask_[at(u, v)], opened_[at(x, y)]);
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
  least_lsb_ = std::max<int64_t>(noise_un[0] / force_lsb_un, 1);
  alone_lsb_ = std::max<int64_t>(noise_un[1] / force_lsb_un, 1);
  return Unit{};
}

}  // namespace ruffini
