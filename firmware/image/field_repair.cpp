#include "image/field_repair.h"

#include <algorithm>
#include <array>
#include <utility>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int kFraction = 4;
constexpr int kResidualShift = 2;  // a residual is 4 x the error of the value
constexpr int kDepthShift = 2;     // log2 of the factor by which depth counts less
constexpr int64_t kSecond2 = 10;   // factor to the second largest residual, squared
constexpr int64_t kThird2 = 49;

// Squared norm of a residual.
int64_t square(const FieldValue& r) {
  const int64_t z = r.z >> kDepthShift;
  return int64_t{r.x} * r.x + int64_t{r.y} * r.y + z * z;
}

}  // namespace

FieldRepair::FieldRepair(GridSize size)
    : size_(size),
      value_(static_cast<size_t>((size.n_x + 2) * (size.n_y + 2))),
      residual2_(static_cast<size_t>(size.count())),
      known_(residual2_.size()),
      reached_(residual2_.size()),
      next_(residual2_.size()) {
  places_.reserve(residual2_.size());
}

int32_t FieldRepair::least_q3(int64_t pitch_x_um, int64_t pitch_y_um, int64_t thickness_um) {
  if (8 * std::max(pitch_x_um, pitch_y_um) > 3 * thickness_um) return kNoOutliers;
  const int64_t least_um_q3 = 8 * std::min(pitch_x_um, pitch_y_um) / kPitchesOfOutlier;
  return static_cast<int32_t>(std::max(least_um_q3, 8 * kMinOutlierUm));
}

// Visits the up to eight neighbours.
template <typename Visit>
void FieldRepair::for_each_neighbour(int x, int y, Visit visit) const {
  for (int v = std::max(y - 1, 0); v <= std::min(y + 1, size_.n_y - 1); ++v) {
    for (int u = std::max(x - 1, 0); u <= std::min(x + 1, size_.n_x - 1); ++u) {
      if (u != x || v != y) visit(u, v);
    }
  }
}

// Fills ring by ring with the mean of the known or reached neighbours, rounded down.
void FieldRepair::fill_rings() {
  std::copy(known_.begin(), known_.end(), reached_.begin());
  for (bool has_grown = true; has_grown;) {
    has_grown = false;
    std::copy(reached_.begin(), reached_.end(), next_.begin());
    for (int y = 0; y < size_.n_y; ++y) {
      for (int x = 0; x < size_.n_x; ++x) {
        if (reached_[index(x, y)] != 0) continue;
        FieldValue sum;
        int32_t n = 0;
        for_each_neighbour(x, y, [&](int u, int v) {
          if (reached_[index(u, v)] == 0) return;
          const FieldValue& beside = value_[padded(u, v)];
          sum = {sum.x + beside.x, sum.y + beside.y, sum.z + beside.z};
          ++n;
        });
        if (n == 0) continue;
        const auto mean = [&](int32_t total) { return static_cast<int32_t>(floor_div(total, n)); };
        value_[padded(x, y)] = {mean(sum.x), mean(sum.y), mean(sum.z)};
        next_[index(x, y)] = 1;
        has_grown = true;
      }
    }
    std::swap(reached_, next_);
  }
}

void FieldRepair::fill_plate() {
  const auto relaxed = [&](int x, int y, int32_t FieldValue::* axis) {
    const auto at = [&](int u, int v) { return int64_t{value_[padded(x + u, y + v)].*axis}; };
    const int64_t sum = 8 * (at(1, 0) + at(-1, 0) + at(0, 1) + at(0, -1)) -
                        2 * (at(1, 1) + at(1, -1) + at(-1, 1) + at(-1, -1)) -
                        (at(2, 0) + at(-2, 0) + at(0, 2) + at(0, -2));
    return static_cast<int32_t>(
        std::clamp<int64_t>(floor_div(sum + 10, 20), -(kMaxInput << kFraction), (kMaxInput - 1) << kFraction));
  };
  places_.clear();
  for (int y = 2; y + 2 < size_.n_y; ++y) {
    for (int x = 2; x + 2 < size_.n_x; ++x) {
      if (known_[index(x, y)] == 0) places_.push_back({x, y});
    }
  }
  for (int sweep = 0; sweep < kSweeps; ++sweep) {
    for (const auto& [x, y] : places_) {
      value_[padded(x, y)] = {relaxed(x, y, &FieldValue::x), relaxed(x, y, &FieldValue::y),
                              relaxed(x, y, &FieldValue::z)};
    }
  }
}

void FieldRepair::fill() {
  const auto n_missing = std::count(known_.begin(), known_.end(), uint8_t{0});
  if (n_missing == 0) return;
  fill_rings();
  if (kMaxMissingPart * n_missing <= std::ssize(known_)) fill_plate();
}

// Extends the field beyond the border on the lines that (x, y) determines.
void FieldRepair::extend(int x, int y) {
  const auto beyond = [&](int u, int v, int du, int dv) {
    const FieldValue& border = value_[padded(u, v)];
    const FieldValue& inside = value_[padded(u + du, v + dv)];
    return FieldValue{2 * border.x - inside.x, 2 * border.y - inside.y, 2 * border.z - inside.z};
  };
  value_[padded(x, -1)] = beyond(x, 0, 0, 1);
  value_[padded(x, size_.n_y)] = beyond(x, size_.n_y - 1, 0, -1);
  for (const int row : {-1, y, size_.n_y}) {
    value_[padded(-1, row)] = beyond(0, row, 1, 0);
    value_[padded(size_.n_x, row)] = beyond(size_.n_x - 1, row, -1, 0);
  }
}

void FieldRepair::extend_all() {
  for (int x = 0; x < size_.n_x; ++x) extend(x, 0);
  for (int y = 0; y < size_.n_y; ++y) extend(0, y);
}

FieldValue FieldRepair::residual(int x, int y) const {
  const FieldValue* middle = &value_[padded(x, y)];
  const auto row = static_cast<ptrdiff_t>(size_.n_x + 2);
  const auto along = [&](int32_t FieldValue::* axis) {
    const auto line = [&](ptrdiff_t step) { return 2 * middle->*axis - middle[step].*axis - middle[-step].*axis; };
    const int32_t a = line(1), b = line(row), c = line(row + 1), d = line(row - 1);
    // Sum of the two middle values of four: all minus the smallest and the largest.
    return std::max(std::min(a, b), std::min(c, d)) + std::min(std::max(a, b), std::max(c, d));
  };
  return {along(&FieldValue::x), along(&FieldValue::y), along(&FieldValue::z)};
}

bool FieldRepair::is_candidate(int x, int y, int64_t least2) const {
  const size_t i = index(x, y);
  if (residual2_[i] <= least2 || known_[i] == 0) return false;
  bool is_largest = true;
  for_each_neighbour(x, y, [&](int u, int v) {
    const size_t j = index(u, v);
    is_largest &= known_[j] == 0 || residual2_[j] <= residual2_[i];
  });
  return is_largest;
}

// Replaces the value by its neighbours' prediction if they agree afterwards.
bool FieldRepair::remove_outlier(int x, int y) {
  FieldValue& value = value_[padded(x, y)];
  const FieldValue given = value;
  const FieldValue own = residual(x, y);
  value = {given.x - (own.x >> kResidualShift), given.y - (own.y >> kResidualShift),
           given.z - (own.z >> kResidualShift)};
  extend(x, y);
  std::array<int64_t, 3> largest{};
  for_each_neighbour(x, y, [&](int u, int v) {
    int64_t size2 = square(residual(u, v));
    for (int64_t& place : largest) {
      if (size2 > place) std::swap(size2, place);
    }
  });
  if (square(own) > kSecond2 * largest[1] || square(own) > kThird2 * largest[2]) {
    known_[index(x, y)] = 0;
    return true;
  }
  value = given;
  extend(x, y);
  return false;
}

int FieldRepair::find_outliers(int64_t least) {
  const int64_t least2 = (least << (kFraction + kResidualShift)) * (least << (kFraction + kResidualShift));
  extend_all();
  const auto each = [&](auto visit) {
    for (int y = 0; y < size_.n_y; ++y) {
      for (int x = 0; x < size_.n_x; ++x) visit(x, y);
    }
  };
  const auto renew = [&](int x, int y) { residual2_[index(x, y)] = square(residual(x, y)); };
  each(renew);
  int n_found = 0;
  for (int round = 0; round < kRounds; ++round) {
    places_.clear();
    each([&](int x, int y) {
      if (is_candidate(x, y, least2) && remove_outlier(x, y)) places_.push_back({x, y});
    });
    if (places_.empty()) break;
    n_found += static_cast<int>(places_.size());
    for (const auto& [x, y] : places_) {
      renew(x, y);
      for_each_neighbour(x, y, renew);
    }
  }
  return n_found;
}

int FieldRepair::run(std::span<FieldValue> field, std::span<uint8_t> is_missing, int32_t least) {
  const auto place = [&](size_t i) { return padded(static_cast<int>(i) % size_.n_x, static_cast<int>(i) / size_.n_x); };
  for (size_t i = 0; i < field.size(); ++i) {
    value_[place(i)] = {field[i].x << kFraction, field[i].y << kFraction, field[i].z << kFraction};
    known_[i] = is_missing[i] == 0 ? 1 : 0;
  }
  if (std::find(known_.begin(), known_.end(), uint8_t{1}) == known_.end()) return 0;
  fill();
  int n_outliers = 0;
  if (std::min(size_.n_x, size_.n_y) >= kMinLines) n_outliers = find_outliers(least);
  if (n_outliers > 0) fill();
  for (size_t i = 0; i < field.size(); ++i) {
    if (known_[i] != 0) continue;
    if (is_missing[i] == 0) is_missing[i] = kOutlier;
    const FieldValue& filled = value_[place(i)];
    const auto rounded = [](int32_t q4) { return static_cast<int32_t>(round_shift(q4, kFraction)); };
    field[i] = {rounded(filled.x), rounded(filled.y), rounded(filled.z)};
  }
  return n_outliers;
}

}  // namespace ruffini
