#include "solve/node_sigma.h"

#include <algorithm>
#include <bit>
#include <numeric>

#include "base/filled.h"
#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int kTableFraction = 8;
constexpr int kFactorFraction = 16;
constexpr int kDifferenceFraction = 3;  // eighths of a step
constexpr int kRoughShift = 6;
constexpr int32_t kSmallestVariance = 1 << kTableFraction;

int bit_width(int64_t x) { return static_cast<int>(std::bit_width(static_cast<uint64_t>(x))); }

int64_t magnitude(int64_t x) { return x < 0 ? -x : x; }

}  // namespace

int64_t floor_sqrt(int64_t x) {
  int64_t root = 0;
  int64_t rest = x;
  // Bit by bit from the top: keeps a bit if (root + bit)^2 <= x.
  for (int shift = x == 0 ? -1 : (bit_width(x) - 1) / 2; shift >= 0; --shift) {
    const int64_t tried = ((root << 1) + (int64_t{1} << shift)) << shift;
    if (tried > rest) continue;
    rest -= tried;
    root += int64_t{1} << shift;
  }
  return root;
}

// Clamped forces of a node, and statistics of its neighbourhood.
struct NodeSigmaModel::Neighbours {
  std::array<int64_t, 3> force{};
  std::array<int64_t, 3> sum{};   // over the eight neighbours
  std::array<int64_t, 3> step{};  // largest difference from a neighbour
  int64_t pressure = 0;           // largest |f_z| of the neighbours
  int64_t rough = 0;              // r^2
  int64_t weight = 0;             // Q7
  bool is_silent = true;          // no force here or at a neighbour
};

Result<NodeSigmaModel> NodeSigmaModel::load(const Calibration& calibration, GridSize nodes, int64_t threshold_lsb,
                                            int64_t stiffness_q20) {
  NodeSigmaModel out;
  out.stiffness2_q16_ = round_shift(stiffness_q20 * stiffness_q20, 24);
  out.nodes_ = nodes;
  out.threshold_lsb_ = threshold_lsb;
  for (auto* plane : {&out.contrast2_, &out.along_x_, &out.rough_}) {
    plane->resize(static_cast<size_t>(nodes.count()));
  }
  auto reported = calibration.tensor("support.error_reported", Tensor::Type::kI32, {2, kReportedLevels});
  if (!reported) return reported.error();
  auto quiet = calibration.tensor("support.error_quiet", Tensor::Type::kI32, {2, kQuietLevels});
  if (!quiet) return quiet.error();
  auto local = calibration.tensor("support.error_local", Tensor::Type::kI32, {2, kLocalTerms});
  if (!local) return local.error();
  for (size_t i = 0; i < 2; ++i) {
    out.axis_[i] = {reported.value()->as<int32_t>().subspan(i * kReportedLevels, kReportedLevels),
                    quiet.value()->as<int32_t>().subspan(i * kQuietLevels, kQuietLevels),
                    local.value()->as<int32_t>().subspan(i * kLocalTerms, kLocalTerms)};
    const auto is_too_small = [](int32_t v) { return v < kSmallestVariance; };
    const auto is_outside = [](int32_t v) { return v < 0 || v > kMaxFactor; };
    if (std::any_of(out.axis_[i].reported.begin(), out.axis_[i].reported.end(), is_too_small) ||
        std::any_of(out.axis_[i].quiet.begin(), out.axis_[i].quiet.end(), is_too_small) ||
        std::any_of(out.axis_[i].local.begin(), out.axis_[i].local.end(), is_outside)) {
      return Error{ErrorKind::kBadInput,
                   "calibration file: support.error_* states no error or one out of range: make the operator again"};
    }
  }
  return out;
}

int32_t NodeSigmaModel::sigma_of(const Axis& axis, const Neighbours& around, size_t component) const {
  const int64_t f = around.force[component];
  const int level = bit_width(magnitude(around.force[2]));
  const int beside = (bit_width(around.pressure) + 1) / 2;
  const int64_t table = level > 0 ? axis.reported[static_cast<size_t>(std::min(level, kReportedLevels) - 1)]
                                  : axis.quiet[static_cast<size_t>(std::min(beside, kQuietLevels - 1))];
  const auto contrast2 = [&](size_t c) {
    const int64_t difference = 8 * around.force[c] - around.sum[c];
    return (difference * difference) >> (2 * kDifferenceFraction);
  };
  const auto weighted = [&](int64_t square) { return round_shift(around.weight * square, ContactMask::kFraction); };
  const int64_t sum = (axis.local[0] + stiffness2_q16_) * (f * f) + axis.local[1] * weighted(contrast2(component)) +
                      axis.local[2] * (around.step[component] * around.step[component]) +
                      axis.local[3] * weighted(around.rough);
  const int64_t variance = table + (sum >> (kFactorFraction - kTableFraction));
  // The root of a number with 8 fraction bits has 4.
  return static_cast<int32_t>(std::max<int64_t>(round_shift(floor_sqrt(variance), kTableFraction / 2), 1));
}

// Statistics of the neighbours of (x, y); nodes outside the grid count as zero.
NodeSigmaModel::Neighbours NodeSigmaModel::neighbours_of(std::span<const NodeForce> force, int x, int y) const {
  const auto force_at = [&](int u, int v) -> std::array<int64_t, 3> {
    if (v < 0 || v >= nodes_.n_y || u < 0 || u >= nodes_.n_x) return {};
    const NodeForce& f = force[static_cast<size_t>(v * nodes_.n_x + u)];
    const auto at_most = [](int64_t value) { return std::clamp(value, -kMaxForce, kMaxForce); };
    return {at_most(f.x), at_most(f.y), at_most(f.z)};
  };
  Neighbours around;
  around.force = force_at(x, y);
  around.is_silent = around.force == std::array<int64_t, 3>{};
  for (int v = y - 1; v <= y + 1; ++v) {
    for (int u = x - 1; u <= x + 1; ++u) {
      if (v == y && u == x) continue;
      const auto beside = force_at(u, v);
      for (size_t c = 0; c < 3; ++c) {
        around.sum[c] += beside[c];
        around.step[c] = std::max(around.step[c], magnitude(around.force[c] - beside[c]));
        around.is_silent &= beside[c] == 0;
      }
      around.pressure = std::max(around.pressure, magnitude(beside[2]));
    }
  }
  around.weight = std::clamp<int64_t>(-around.force[2], 0, threshold_lsb_) * ContactMask::kFull / threshold_lsb_;
  return around;
}

NodeSigmaModel::Box NodeSigmaModel::forced(std::span<const NodeForce> force) const {
  Box box{.min_x = nodes_.n_x, .max_x = -1, .min_y = nodes_.n_y, .max_y = -1};
  const NodeForce* f = force.data();
  for (int y = 0; y < nodes_.n_y; ++y) {
    for (int x = 0; x < nodes_.n_x; ++x, ++f) {
      if ((f->x | f->y | f->z) == 0) continue;
      box = {std::min(box.min_x, x), std::max(box.max_x, x), std::min(box.min_y, y), y};
    }
  }
  return box;
}

NodeSigmaModel::Box NodeSigmaModel::grown(const Box& box, int reach) const {
  if (box.min_x > box.max_x) return box;
  return {std::max(box.min_x - reach, 0), std::min(box.max_x + reach, nodes_.n_x - 1), std::max(box.min_y - reach, 0),
          std::min(box.max_y + reach, nodes_.n_y - 1)};
}

// r^2: sums over 7 nodes of a row, then over 7 rows. d_z is zero outside `loud`.
void NodeSigmaModel::find_roughness(std::span<const NodeForce> force, const Box& loud) {
  const auto at = [&](int x, int y) { return static_cast<size_t>(y * nodes_.n_x + x); };
  for (int y = loud.min_y; y <= loud.max_y; ++y) {
    for (int x = loud.min_x; x <= loud.max_x; ++x) {
      const auto pull = [&](int u, int v) { return std::clamp<int64_t>(force[at(u, v)].z, -kMaxForce, kMaxForce); };
      int64_t difference = 9 * pull(x, y);
      for (int v = std::max(y - 1, 0); v <= std::min(y + 1, nodes_.n_y - 1); ++v) {
        for (int u = std::max(x - 1, 0); u <= std::min(x + 1, nodes_.n_x - 1); ++u) difference -= pull(u, v);
      }
      contrast2_[at(x, y)] = (difference * difference) >> (2 * kDifferenceFraction);
    }
  }
  for (int y = loud.min_y; y <= loud.max_y; ++y) {
    const int64_t* row = &contrast2_[at(0, y)];
    for (int x = loud.min_x; x <= loud.max_x; ++x) {
      along_x_[at(x, y)] = std::accumulate(row + std::max(x - kRoughReach, loud.min_x),
                                           row + std::min(x + kRoughReach, loud.max_x) + 1, int64_t{0});
    }
  }
  for (int y = loud.min_y; y <= loud.max_y; ++y) {
    for (int x = loud.min_x; x <= loud.max_x; ++x) {
      int64_t sum = 0;
      for (int v = std::max(y - kRoughReach, loud.min_y); v <= std::min(y + kRoughReach, loud.max_y); ++v) {
        sum += along_x_[at(x, v)];
      }
      rough_[at(x, y)] = sum >> kRoughShift;
    }
  }
}

void NodeSigmaModel::run(std::span<const NodeForce> force, std::span<const uint8_t> filled,
                         std::span<NodeSigma> sigma) {
  const Box loud = grown(forced(force), 1);
  find_roughness(force, loud);
  const auto sigma_with = [&](const Neighbours& around) {
    return NodeSigma{sigma_of(axis_[0], around, 0), sigma_of(axis_[0], around, 1), sigma_of(axis_[1], around, 2)};
  };
  const NodeSigma silent = sigma_with({});
  std::fill(sigma.begin(), sigma.end(), silent);
  for (int y = loud.min_y; y <= loud.max_y; ++y) {
    for (int x = loud.min_x; x <= loud.max_x; ++x) {
      const auto i = static_cast<size_t>(y * nodes_.n_x + x);
      Neighbours around = neighbours_of(force, x, y);
      around.rough = rough_[i];
      if (!around.is_silent) sigma[i] = sigma_with(around);
    }
  }
  grow_filled(filled, sigma);
}

void NodeSigmaModel::grow_filled(std::span<const uint8_t> filled, std::span<NodeSigma> sigma) const {
  const auto at = [&](int x, int y) { return static_cast<size_t>(y * nodes_.n_x + x); };
  const auto most_beside = [&](int x, int y) {
    uint8_t most = kNothingFilled;
    for (int v = std::max(y - 1, 0); v <= std::min(y + 1, nodes_.n_y - 1); ++v) {
      for (int u = std::max(x - 1, 0); u <= std::min(x + 1, nodes_.n_x - 1); ++u)
        most = std::max(most, filled[at(u, v)]);
    }
    return most;
  };
  const auto grown = [](int32_t s, int32_t halves) { return (s * halves + 1) / 2; };
  if (std::all_of(filled.begin(), filled.end(), [](uint8_t f) { return f == kNothingFilled; })) return;
  for (int y = 0; y < nodes_.n_y; ++y) {
    for (int x = 0; x < nodes_.n_x; ++x) {
      const uint8_t most = most_beside(x, y);
      if (most == kNothingFilled) continue;
      const uint8_t own = filled[at(x, y)];
      NodeSigma& s = sigma[at(x, y)];
      const int32_t shear = own == kNothingFilled ? kBesideFilled_halves : kFilledShear_halves;
      s.x = grown(s.x, shear);
      s.y = grown(s.y, shear);
      if (most == kAllFilled) s.z = grown(s.z, own == kAllFilled ? kFilledNormal_halves : kBesideFilled_halves);
    }
  }
}

}  // namespace ruffini
