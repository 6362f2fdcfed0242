#include "image/field_repair.h"

#include <algorithm>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int kFraction = 4;
constexpr int64_t kResidualScale = 4;  // of residual2's root over the value
constexpr int64_t kSecond2 = 9;        // (3 x)^2
constexpr int64_t kThird2 = 25;        // (5 x)^2

}  // namespace

FieldRepair::FieldRepair(GridSize size)
    : size_(size),
      given_(static_cast<size_t>(size.count())),
      filled_(given_.size()),
      padded_(static_cast<size_t>((size.n_x + 2) * (size.n_y + 2))),
      residual2_(given_.size()),
      known_(given_.size()),
      rest_(given_.size()),
      reached_(given_.size()),
      next_(given_.size()),
      is_candidate_(given_.size()),
      is_tried_(given_.size()) {}

int32_t FieldRepair::least_q3(int64_t pitch_x_um, int64_t pitch_y_um) {
  const int64_t least_um_q3 = 8 * std::min(pitch_x_um, pitch_y_um) / kPitchesOfOutlier;
  return static_cast<int32_t>(std::max(least_um_q3, 8 * kLeastOutlierUm));
}

// The up to eight neighbours.
template <typename Visit>
void FieldRepair::around(size_t at, Visit visit) const {
  const int x = static_cast<int>(at) % size_.n_x;
  const int y = static_cast<int>(at) / size_.n_x;
  for (int v = std::max(y - 1, 0); v <= std::min(y + 1, size_.n_y - 1); ++v) {
    for (int u = std::max(x - 1, 0); u <= std::min(x + 1, size_.n_x - 1); ++u) {
      if (u != x || v != y) visit(index(u, v));
    }
  }
}

// filled_ = given_ where known, elsewhere ring by ring the mean of the neighbours, rounded down.
void FieldRepair::fill_rings(std::span<const uint8_t> known) {
  std::copy(given_.begin(), given_.end(), filled_.begin());
  std::copy(known.begin(), known.end(), reached_.begin());
  for (bool has_grown = std::find(known.begin(), known.end(), uint8_t{0}) != known.end(); has_grown;) {
    has_grown = false;
    std::copy(reached_.begin(), reached_.end(), next_.begin());
    for (size_t i = 0; i < filled_.size(); ++i) {
      if (reached_[i] != 0) continue;
      int64_t x = 0, y = 0, n = 0;
      around(i, [&](size_t j) {
        if (reached_[j] == 0) return;
        x += filled_[j].x;
        y += filled_[j].y;
        ++n;
      });
      if (n == 0) continue;
      filled_[i] = {static_cast<int32_t>(floor_div(x, n)), static_cast<int32_t>(floor_div(y, n))};
      next_[i] = 1;
      has_grown = true;
    }
    std::swap(reached_, next_);
  }
}

// Precondition: padded_ holds the field and one line beyond each border.
int64_t FieldRepair::residual2(int x, int y) const {
  const auto middle2 = [&](int32_t FieldValue::* axis) {
    const auto at = [&](int u, int v) { return padded_[padded(x + u, y + v)].*axis; };
    const int32_t twice = 2 * at(0, 0);
    std::array<int32_t, 4> line = {twice - at(1, 0) - at(-1, 0), twice - at(0, 1) - at(0, -1),
                                   twice - at(1, 1) - at(-1, -1), twice - at(1, -1) - at(-1, 1)};
    const auto [lowest, highest] = std::minmax({line[0], line[1], line[2], line[3]});
    const int64_t sum = int64_t{line[0]} + line[1] + line[2] + line[3] - lowest - highest;
    return sum * sum;
  };
  return middle2(&FieldValue::x) + middle2(&FieldValue::y);
}

// Of filled_.
void FieldRepair::find_residuals() {
  const auto beyond = [](const FieldValue& border, const FieldValue& inside) {
    return FieldValue{2 * border.x - inside.x, 2 * border.y - inside.y};
  };
  const auto [n_x, n_y] = std::pair{size_.n_x, size_.n_y};
  for (int y = 0; y < n_y; ++y) {
    std::copy_n(&filled_[index(0, y)], n_x, &padded_[padded(0, y)]);
  }
  for (int x = 0; x < n_x; ++x) {
    padded_[padded(x, -1)] = beyond(padded_[padded(x, 0)], padded_[padded(x, 1)]);
    padded_[padded(x, n_y)] = beyond(padded_[padded(x, n_y - 1)], padded_[padded(x, n_y - 2)]);
  }
  for (int y = -1; y <= n_y; ++y) {
    padded_[padded(-1, y)] = beyond(padded_[padded(0, y)], padded_[padded(1, y)]);
    padded_[padded(n_x, y)] = beyond(padded_[padded(n_x - 1, y)], padded_[padded(n_x - 2, y)]);
  }
  for (int y = 0; y < n_y; ++y) {
    for (int x = 0; x < n_x; ++x) residual2_[index(x, y)] = residual2(x, y);
  }
}

// Known ones not yet tried whose residual is the largest around; false = none.
bool FieldRepair::choose_candidates(int64_t least2) {
  const auto is_open = [&](size_t i) { return known_[i] != 0 && is_tried_[i] == 0; };
  bool has_any = false;
  for (size_t i = 0; i < known_.size(); ++i) {
    is_candidate_[i] = 0;
    if (residual2_[i] <= least2 || !is_open(i)) continue;
    bool is_largest = true;
    around(i, [&](size_t j) { is_largest &= !is_open(j) || residual2_[j] <= residual2_[i]; });
    is_candidate_[i] = is_largest ? 1 : 0;
    has_any |= is_largest;
  }
  return has_any;
}

// Precondition: filled_ and residual2_ are without the candidates.
bool FieldRepair::is_contradicted(size_t at) const {
  std::array<int64_t, 3> largest{};
  around(at, [&](size_t j) {
    int64_t value = residual2_[j];
    for (int64_t& place : largest) {
      if (value > place) std::swap(value, place);
    }
  });
  const int64_t x = given_[at].x - filled_[at].x;
  const int64_t y = given_[at].y - filled_[at].y;
  const int64_t off2 = kResidualScale * kResidualScale * (x * x + y * y);
  return off2 > kSecond2 * largest[1] || off2 > kThird2 * largest[2];
}

int FieldRepair::find_outliers(int64_t least) {
  std::fill(is_tried_.begin(), is_tried_.end(), uint8_t{0});
  const int64_t least2 = (kResidualScale * least << kFraction) * (kResidualScale * least << kFraction);
  int n_found = 0;
  for (int round = 0; round < kRounds; ++round) {
    fill_rings(known_);
    find_residuals();
    if (!choose_candidates(least2)) break;
    for (size_t i = 0; i < rest_.size(); ++i) rest_[i] = known_[i] != 0 && is_candidate_[i] == 0 ? 1 : 0;
    fill_rings(rest_);
    find_residuals();
    const int n_before = n_found;
    for (size_t i = 0; i < known_.size(); ++i) {
      if (is_candidate_[i] == 0) continue;
      if (is_contradicted(i)) {
        known_[i] = 0;
        ++n_found;
      } else {
        is_tried_[i] = 1;
      }
    }
    if (n_found > n_before) std::fill(is_tried_.begin(), is_tried_.end(), uint8_t{0});
  }
  return n_found;
}

void FieldRepair::fill_plate() {
  const auto relaxed = [&](int x, int y, int32_t FieldValue::* axis) {
    const auto at = [&](int u, int v) { return int64_t{filled_[index(x + u, y + v)].*axis}; };
    const int64_t sum = 8 * (at(1, 0) + at(-1, 0) + at(0, 1) + at(0, -1)) -
                        2 * (at(1, 1) + at(1, -1) + at(-1, 1) + at(-1, -1)) -
                        (at(2, 0) + at(-2, 0) + at(0, 2) + at(0, -2));
    return static_cast<int32_t>(
        std::clamp<int64_t>(floor_div(sum + 10, 20), -(kMaxInput << kFraction), (kMaxInput - 1) << kFraction));
  };
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (int y = 2; y + 2 < size_.n_y; ++y) {
      for (int x = 2; x + 2 < size_.n_x; ++x) {
        if (known_[index(x, y)] != 0) continue;
        filled_[index(x, y)] = {relaxed(x, y, &FieldValue::x), relaxed(x, y, &FieldValue::y)};
      }
    }
  }
}

int FieldRepair::run(std::span<FieldValue> field, std::span<uint8_t> is_missing, int32_t least) {
  for (size_t i = 0; i < field.size(); ++i) {
    given_[i] = {field[i].x << kFraction, field[i].y << kFraction};
    known_[i] = is_missing[i] == 0 ? 1 : 0;
  }
  const auto n_known = [&] { return std::count(known_.begin(), known_.end(), uint8_t{1}); };
  if (n_known() == 0) return 0;
  int n_outliers = 0;
  if (std::min(size_.n_x, size_.n_y) >= kFewestLines) n_outliers = find_outliers(least);
  const auto n_missing = std::ssize(known_) - n_known();
  if (n_missing == 0) return 0;
  fill_rings(known_);
  if (kMostPlatePart * n_missing <= std::ssize(known_)) fill_plate();
  for (size_t i = 0; i < field.size(); ++i) {
    if (known_[i] != 0) continue;
    if (is_missing[i] == 0) is_missing[i] = kOutlier;
    field[i] = {static_cast<int32_t>(round_shift(filled_[i].x, kFraction)),
                static_cast<int32_t>(round_shift(filled_[i].y, kFraction))};
  }
  return n_outliers;
}

}  // namespace ruffini
