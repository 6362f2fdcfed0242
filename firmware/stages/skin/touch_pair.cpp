#include "stages/skin/touch_pair.h"

#include <algorithm>
#include <cstdlib>

#include "base/fixed.h"
#include "solve/node_sigma.h"

namespace ruffini {
namespace {

constexpr int64_t kOneQ12 = 4096;
constexpr int64_t kMinSinkQ12 = -kOneQ12;
constexpr int64_t kMaxSinkQ12 = 16 * kOneQ12;
constexpr int kSinkShift = 9;    // from Q4 of the weight and Q12 to half of Q8
constexpr int kReachShift = 11;  // from Q4 and Q14 to half of Q8
constexpr int kProductShift = 10;
constexpr int64_t kMaxFeature = (1 << 15) - 1;  // keeps the products below from overflowing
constexpr int64_t kMaxStrengthQ12 = 1 << 20;
constexpr int64_t kMinTurn = 1024;  // own products over the determinant: beyond it the two places coincide

int64_t product(const std::array<int32_t, 2 * TouchPair::kCells>& a,
                const std::array<int32_t, 2 * TouchPair::kCells>& b) {
  int64_t sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += int64_t{a[i]} * b[i];
  return sum >> kProductShift;
}

int walk(const TaxelTables& tables, int from, size_t way, int steps) {
  for (; steps > 0 && from >= 0; --steps) from = tables.taxels[static_cast<size_t>(from)].near[way];
  return from;
}

}  // namespace

void TouchPair::load_patch(const TaxelTables& tables, std::span<const int64_t> sink_q12, size_t taxel) {
  taxel_ = taxel;
  Values value{};
  for (int row = 0; row < kRows; ++row) {
    const int up = row - kRows / 2;
    const int start = walk(tables, static_cast<int>(taxel), up < 0 ? 2 : 3, std::abs(up));
    for (int column = 0; column < kColumns; ++column) {
      const int aside = column - kColumns / 2;
      const auto i = static_cast<size_t>(row * kColumns + column);
      node_[i] = walk(tables, start, aside < 0 ? 0 : 1, std::abs(aside));
      value[i] = node_[i] < 0 ? 0 : std::clamp(sink_q12[static_cast<size_t>(node_[i])], kMinSinkQ12, kMaxSinkQ12);
    }
  }
  n_cells_ = 0;
  for (size_t cell = 0; cell < kCells; ++cell) {
    const int64_t part_q12 = kPartQ8 * std::max<int64_t>(value[cell + kColumns], 0) >> 8;
    const bool is_there = node_[cell + kColumns] >= 0;
    weight_q4_[cell] = is_there ? 16 * kOneQ12 / floor_sqrt(kNoiseQ12 * kNoiseQ12 + part_q12 * part_q12) : 0;
    n_cells_ += is_there ? 1 : 0;
  }
  describe(value, kSinkShift, seen_);
}

// Sinks, then curvatures, of the patch's taxels; the skin is mirrored at its rim.
void TouchPair::describe(const Values& value, int shift, Features& out) const {
  for (size_t cell = 0; cell < kCells; ++cell) {
    const size_t here = cell + kColumns;
    const bool has_above = node_[here - kColumns] >= 0;
    const bool has_below = node_[here + kColumns] >= 0;
    const int64_t above = value[has_above ? here - kColumns : has_below ? here + kColumns : here];
    const int64_t below = value[has_below ? here + kColumns : has_above ? here - kColumns : here];
    const int64_t sink = round_shift(weight_q4_[cell] * value[here], shift);
    const int64_t bend = round_shift(weight_q4_[cell] * (2 * value[here] - above - below), shift);
    out[cell] = static_cast<int32_t>(std::clamp(sink, -kMaxFeature, kMaxFeature));
    out[kCells + cell] = static_cast<int32_t>(std::clamp(bend, -kMaxFeature, kMaxFeature));
  }
}

void TouchPair::place(const TaxelTables& tables, int64_t x_um, int64_t y_um, Place& out) const {
  const TaxelTables::Taxel& middle = tables.taxels[taxel_];
  Values reach{};
  bool is_on_skin = false;
  for (size_t i = 0; i < kNodes; ++i) {
    if (node_[i] < 0) continue;
    const TaxelTables::Taxel& t = tables.taxels[static_cast<size_t>(node_[i])];
    const int64_t dx_um = t.x_um - middle.x_um - x_um;
    const int64_t dy_um = t.y_um - middle.y_um - y_um;
    reach[i] = tables.reach_q14(dx_um, dy_um);
    is_on_skin |= 2 * std::max(tables.wrapped_um(dx_um), std::abs(dy_um)) <= kOnTaxel * tables.reach_step_um;
  }
  out.x_um = x_um;
  out.y_um = y_um;
  if (!is_on_skin) reach.fill(0);  // outside the skin: no effect
  describe(reach, kReachShift, out.made);
  out.own = product(out.made, out.made);
  out.with = product(out.made, seen_);
}

TouchPair::Solved TouchPair::solve(const Place& a, const Place& b, int64_t step_um) const {
  const int64_t dx = a.x_um - b.x_um;
  const int64_t dy = a.y_um - b.y_um;
  const int64_t away2 = dx * dx + dy * dy;
  if (away2 < kNear * kNear * step_um * step_um || away2 > kFar * kFar * step_um * step_um) return {};
  const int64_t both = product(a.made, b.made);
  const int64_t turn = a.own * b.own - both * both;
  if (turn <= 0 || turn * kMinTurn < a.own * b.own) return {};
  Solved out;
  out.strength_q12 = {floor_div((a.with * b.own - b.with * both) * kOneQ12, turn),
                      floor_div((b.with * a.own - a.with * both) * kOneQ12, turn)};
  const auto [first, second] = out.strength_q12;
  if (std::min(first, second) < kMinStrengthQ12 || std::max(first, second) > kMaxStrengthQ12) return {};
  if (kEven[1] * std::max(first, second) > kEven[0] * std::min(first, second)) return {};
  out.gain = (first * a.with + second * b.with) >> 12;
  return out;
}

void TouchPair::place_around(const TaxelTables& tables, const Place& middle, int64_t step_um,
                             std::span<Place, 9> out) const {
  const int64_t x_um = middle.x_um;
  const int64_t y_um = middle.y_um;
  for (size_t i = 0; i < out.size(); ++i) {
    const int64_t column = static_cast<int64_t>(i % 3) - 1;
    const int64_t row = static_cast<int64_t>(i / 3) - 1;
    place(tables, x_um + column * step_um, y_um + row * step_um, out[i]);
  }
}

// Reduction of the sum of squares by one touch, Q6. Fills the grid.
int64_t TouchPair::best_single(const TaxelTables& tables) {
  const int64_t step_um = tables.reach_step_um;
  const auto gain_of = [](const Place& place) {
    return place.with > 0 && place.own > 0 ? floor_div(place.with * place.with, place.own) : 0;
  };
  int64_t gain = -1;
  Place best;
  for (size_t i = 0; i < grid_.size(); ++i) {
    const int64_t column = static_cast<int64_t>(i % kGridSide) * kGridStep - kGridHalf;
    const int64_t row = static_cast<int64_t>(i / kGridSide) * kGridStep - kGridHalf;
    place(tables, column * step_um, row * step_um, grid_[i]);
    if (gain_of(grid_[i]) <= gain) continue;
    gain = gain_of(grid_[i]);
    best = grid_[i];
  }
  for (int round = 0; round < kHalvings * kRounds; ++round) {
    place_around(tables, best, step_um * kGridStep >> (1 + round / kRounds), around_a_);
    for (const Place& place : around_a_) {
      if (gain_of(place) <= gain) continue;
      gain = gain_of(place);
      best = place;
    }
  }
  return gain;
}

// The same for two touches, which become the members; -1: no valid pair.
int64_t TouchPair::best_pair(const TaxelTables& tables) {
  const int64_t step_um = tables.reach_step_um;
  Solved best;
  std::array<Place, 2> at;
  const auto take = [&](const Place& a, const Place& b) {
    const Solved solved = solve(a, b, step_um);
    if (solved.gain <= best.gain) return;
    best = solved;
    at = {a, b};
  };
  for (size_t i = 0; i < grid_.size(); ++i) {
    for (size_t k = i + 1; k < grid_.size(); ++k) take(grid_[i], grid_[k]);
  }
  for (int round = 0; best.gain >= 0 && round < kHalvings * kRounds; ++round) {
    const int64_t finer_um = step_um * kGridStep >> (1 + round / kRounds);
    place_around(tables, at[0], finer_um, around_a_);
    place_around(tables, at[1], finer_um, around_b_);
    for (const Place& a : around_a_) {
      for (const Place& b : around_b_) take(a, b);
    }
  }
  const TaxelTables::Taxel& middle = tables.taxels[taxel_];
  for (size_t k = 0; k < 2; ++k) {
    members_[k] = {middle.x_um + at[k].x_um, middle.y_um + at[k].y_um, best.strength_q12[k]};
  }
  return best.gain;
}

bool TouchPair::find(const TaxelTables& tables, std::span<const int64_t> sink_q12, size_t taxel) {
  load_patch(tables, sink_q12, taxel);
  const int64_t all = product(seen_, seen_);
  const int64_t slack = kSlack * n_cells_ << 6;
  const int64_t one = all - best_single(tables);
  if (one * kSlack * kOneQ12 <= tables.pair_q12 * slack) return false;
  const int64_t gain = best_pair(tables);
  if (gain < 0) return false;
  const int64_t two = all - gain;
  return (one - two) * kSlack * kOneQ12 > tables.pair_q12 * (two + slack);
}

}  // namespace ruffini
