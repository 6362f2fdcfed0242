#include "stages/skin/taxel_touches.h"

#include <algorithm>
#include <cstdlib>

#include "solve/node_sigma.h"

namespace ruffini {
namespace {

constexpr int64_t kOneQ12 = 4096;
constexpr int64_t kMinReachQ14 = 1 << 10;  // strength is unreliable where a touch has less reach

int64_t read_table(const std::vector<int32_t>& table, int64_t ratio_q12) {
  const int64_t at =
      std::clamp<int64_t>(ratio_q12 + kOneQ12, 0, int64_t{TaxelTables::kStep} * (TaxelTables::kSize - 1));
  const int64_t i = std::min<int64_t>(at / TaxelTables::kStep, TaxelTables::kSize - 2);
  const int64_t part = at - i * TaxelTables::kStep;
  const int32_t* const value = table.data() + i;
  return round_shift(value[0] * (TaxelTables::kStep - part) + value[1] * part, 6);
}
static_assert(TaxelTables::kStep == 1 << 6);

int64_t cubic(const std::array<int64_t, TaxelTables::kCoefficients>& c, int64_t q_q12) {
  int64_t value = c[3];
  for (size_t i = 3; i-- > 0;) value = round_shift(value * q_q12, 12) + c[i];
  return round_shift(value, 8);
}

}  // namespace

Result<TaxelTouches> TaxelTouches::load(const Calibration& calibration, const BoardSettings& board) {
  TaxelTouches out;
  auto tables = TaxelTables::load(calibration, board);
  if (!tables) return tables.error();
  out.tables_ = std::move(tables).value();
  const size_t n = out.tables_.taxels.size();
  if (calibration.has_kind("relaxation")) {
    auto relaxation = Relaxation::load(calibration, static_cast<int>(n));
    if (!relaxation) return relaxation.error();
    out.relaxation_.emplace(std::move(relaxation).value());
  }
  out.force_lsb_un_ = board.force_lsb_un;
  out.threshold_un_ = board.contact.threshold_un;
  out.mode_ = board.skin.mode;
  out.sink_q12_.resize(n);
  out.residual_q12_.resize(n);
  out.press_.resize(n);
  out.all_nodes_.assign(n, 1);
  return out;
}

void TaxelTouches::forget() {
  if (relaxation_) relaxation_->forget();
}

void TaxelTouches::read(std::span<const int32_t> ratio) {
  for (size_t i = 0; i < sink_q12_.size(); ++i) {
    sink_q12_[i] = read_table(tables_.sink_q12, ratio[i]);
    const bool is_touched = sink_q12_[i] >= tables_.floor_q12;
    press_[i] = {0, 0, is_touched ? static_cast<int32_t>(read_table(tables_.press_lsb, ratio[i])) : 0};
  }
}

int64_t TaxelTouches::explained(size_t taxel, const Touch& touch) const {
  const TaxelTables::Taxel& t = tables_.taxels[taxel];
  return round_shift(touch.strength_q12 * tables_.reach_q14(t.x_um - touch.x_um, t.y_um - touch.y_um), 14);
}

// Sink of a taxel that no touch except `except` explains.
int64_t TaxelTouches::residual_sink(size_t taxel, const Touch* except) const {
  int64_t sink = sink_q12_[taxel];
  for (size_t k = 0; k < n_touches_; ++k) {
    if (&touch_[k] != except) sink -= explained(taxel, touch_[k]);
  }
  return sink;
}

// True if a taxel stands out from its neighbours along both axes, as under a finger, but not in the tail of a long
// touch.
bool TaxelTouches::is_peak(size_t taxel) const {
  const auto& near = tables_.taxels[taxel].near;
  for (const size_t axis : {size_t{0}, size_t{1}}) {
    int64_t two = 0;  // sink of both neighbours; twice that of an only neighbour
    for (const size_t side : {size_t{0}, size_t{1}}) {
      const int16_t there = near[2 * axis + side] >= 0 ? near[2 * axis + side] : near[2 * axis + 1 - side];
      if (there >= 0) two += sink_q12_[static_cast<size_t>(there)];
    }
    if ((2 * sink_q12_[taxel] - two) * kPeak < sink_q12_[taxel]) return false;
  }
  return true;
}

// Taxel of a further touch, if there is one.
std::optional<size_t> TaxelTouches::next_taxel() const {
  if (n_touches_ == touch_.size() || (mode_ == SkinMode::kSingle && n_touches_ == 1)) return std::nullopt;
  size_t best = 0;
  int64_t most = tables_.floor_q12 - 1;
  for (size_t i = 0; i < sink_q12_.size(); ++i) {
    if (sink_q12_[i] <= most) continue;
    const int64_t unexplained = residual_sink(i, nullptr);
    if (unexplained <= most) continue;
    int64_t strongest = sink_q12_[i];
    for (size_t k = 0; k < n_touches_; ++k) {
      const bool is_reached = explained(i, touch_[k]) > 0;
      const int64_t strength = std::max(touch_[k].strength_q12, touch_[k].pair_q12);
      strongest = std::max(strongest, strength / (is_reached ? 1 : kBeyond));
    }
    if (unexplained * kOneQ12 < tables_.apart_q12 * strongest) continue;
    if (n_touches_ > 0 && !is_peak(i)) continue;
    best = i;
    most = unexplained;
  }
  return most < tables_.floor_q12 ? std::nullopt : std::optional(best);
}

bool TaxelTouches::find_another() {
  const auto taxel = next_taxel();
  if (!taxel) return false;
  touch_[n_touches_++] = {.taxel = *taxel};
  fit(touch_[n_touches_ - 1]);
  split_last();
  return true;
}

// Splits the last touch in two if two positions explain its taxels much better and none of them stands out.
void TaxelTouches::split_last() {
  if (mode_ == SkinMode::kSingle || n_touches_ == touch_.size()) return;
  const Touch& whole = touch_[n_touches_ - 1];
  if (const auto other = next_taxel()) {
    const int64_t dx_um = tables_.wrapped_um(tables_.taxels[*other].x_um - whole.x_um);
    const int64_t dy_um = tables_.taxels[*other].y_um - whole.y_um;
    const int64_t far_um = TouchPair::kFar * tables_.reach_step_um;
    if (dx_um * dx_um + dy_um * dy_um <= far_um * far_um) return;
  }
  for (size_t i = 0; i < residual_q12_.size(); ++i) residual_q12_[i] = residual_sink(i, &whole);
  if (!pair_.find(tables_, residual_q12_, whole.taxel)) return;
  touch_[n_touches_ - 1] = member(0);
  touch_[n_touches_++] = member(1);
  for (size_t k = n_touches_ - 2; k < n_touches_; ++k) fit(touch_[k]);
}

// A touch at a position of the pair, on the taxel that it reaches most.
TaxelTouches::Touch TaxelTouches::member(size_t k) const {
  const TouchPair::Member& found = pair_.members()[k];
  Touch touch{.x_um = within_round(found.x_um),
              .y_um = found.y_um,
              .strength_q12 = found.strength_q12,
              .q_q12 = {},
              .pair_q12 = pair_.members()[0].strength_q12 + pair_.members()[1].strength_q12};
  int64_t most = -1;
  for (size_t i = 0; i < tables_.taxels.size(); ++i) {
    const int64_t reach = tables_.reach_q14(tables_.taxels[i].x_um - touch.x_um, tables_.taxels[i].y_um - touch.y_um);
    if (reach <= most) continue;
    most = reach;
    touch.taxel = i;
  }
  return touch;
}

// Wraps x around a tube.
int64_t TaxelTouches::within_round(int64_t x_um) const {
  if (tables_.round_um > 0 && 2 * x_um > tables_.round_um) return x_um - tables_.round_um;
  if (tables_.round_um > 0 && 2 * x_um < -tables_.round_um) return x_um + tables_.round_um;
  return x_um;
}

// q along an axis.
int64_t TaxelTouches::lean_q12(const TaxelTables::Taxel& taxel, const Touch& touch, size_t axis, int64_t here) const {
  const int16_t before = taxel.near[2 * axis];
  const int16_t behind = taxel.near[2 * axis + 1];
  int64_t q = 0;
  if (before >= 0 && behind >= 0) {
    const int64_t a = residual_sink(static_cast<size_t>(before), &touch);
    const int64_t b = residual_sink(static_cast<size_t>(behind), &touch);
    q = floor_div((b - a) * kOneQ12, std::max<int64_t>(here - std::min(a, b), 1));
  } else if (before >= 0 || behind >= 0) {
    q = floor_div(residual_sink(static_cast<size_t>(std::max(before, behind)), &touch) * kOneQ12,
                  std::max<int64_t>(here, 1));
  }
  return std::clamp(q, -kOneQ12, kOneQ12);
}

// Computes q; `here`: sink of its taxel that the other touches leave.
void TaxelTouches::lean(Touch& touch, int64_t here) const {
  const TaxelTables::Taxel& taxel = tables_.taxels[touch.taxel];
  for (const size_t axis : {size_t{0}, size_t{1}}) touch.q_q12[axis] = lean_q12(taxel, touch, axis, here);
}

// Fits position and strength with the other touches fixed; the touch may move by one taxel. For one of a pair only q.
void TaxelTouches::fit(Touch& touch) const {
  int64_t here = residual_sink(touch.taxel, &touch);
  if (touch.pair_q12 > 0) {
    lean(touch, here);
    return;
  }
  for (const int16_t other : tables_.taxels[touch.taxel].near) {
    if (other < 0) continue;
    const int64_t there = residual_sink(static_cast<size_t>(other), &touch);
    if (there <= here) continue;
    here = there;
    touch.taxel = static_cast<size_t>(other);
  }
  lean(touch, here);
  const TaxelTables::Taxel& taxel = tables_.taxels[touch.taxel];
  const int64_t dx = cubic(taxel.shift[0], touch.q_q12[0]);
  const int64_t dy = cubic(taxel.shift[1], touch.q_q12[1]);
  touch.x_um = within_round(taxel.x_um + dx);
  touch.y_um = taxel.y_um + dy;
  const int64_t reach = std::max(tables_.reach_q14(dx, dy), kMinReachQ14);
  touch.strength_q12 = std::max<int64_t>(floor_div(here * 16'384, reach), 0);
}

void TaxelTouches::distribute_press() {
  force_lsb_.fill(0);
  n_taxels_.fill(0);
  for (size_t i = 0; i < press_.size(); ++i) {
    if (sink_q12_[i] < tables_.floor_q12) continue;
    std::array<int64_t, SkinTouchList::kMax> part{};
    int64_t sum = 0;
    size_t most = 0;
    for (size_t k = 0; k < n_touches_; ++k) {
      part[k] = explained(i, touch_[k]);
      sum += part[k];
      if (part[k] > part[most]) most = k;
    }
    if (sum == 0) continue;
    ++n_taxels_[most];
    for (size_t k = 0; k < n_touches_; ++k) force_lsb_[k] += floor_div(press_[i].z * part[k], sum);
  }
}

int64_t TaxelTouches::force_un(const Touch& touch, int64_t elastic_lsb) const {
  const int64_t elastic_un = elastic_lsb * force_lsb_un_;
  const std::array<int64_t, 2> lean = {std::abs(touch.q_q12[0]), std::abs(touch.q_q12[1])};
  return round_shift(elastic_un * tables_.gain_of(tables_.taxels[touch.taxel].kind, elastic_un, lean), 16);
}

SkinTouch TaxelTouches::to_skin_touch(size_t k) const {
  const Touch& t = touch_[k];
  const int64_t force_un = this->force_un(t, force_lsb_[k]);
  const TaxelTables::Sigma& sigma = tables_.sigma[tables_.taxels[t.taxel].kind];
  const int64_t part_un = round_shift(force_un * sigma.force_q12, 12);
  const int64_t faint_um = floor_div(sigma.faint_place_um * threshold_un_, std::max(force_un, threshold_un_));
  return {.x_um = t.x_um,
          .y_um = t.y_um,
          .area_um2 = n_taxels_[k] * tables_.taxel_area_um2,
          .brightness_q2 = t.strength_q12,
          .press_un = force_un,
          .press_sigma_un = floor_sqrt(sigma.force_un * sigma.force_un + part_un * part_un),
          .place_sigma_um = sigma.place_um + faint_um};
}

SkinTouchList TaxelTouches::run(std::span<const int32_t> ratio, uint64_t capture_us, bool is_trusted,
                                SaturationCounter& saturations) {
  read(ratio);
  if (relaxation_ && is_trusted && capture_us != 0) relaxation_->run(capture_us, all_nodes_, press_, saturations);
  n_touches_ = 0;
  while (find_another()) {
    if (n_touches_ == 1) continue;  // nothing to refit
    for (int round = 0; round < kRounds; ++round) {
      for (size_t k = 0; k < n_touches_; ++k) fit(touch_[k]);
    }
  }
  distribute_press();
  SkinTouchList list;
  for (size_t k = 0; k < n_touches_; ++k) {
    const SkinTouch touch = to_skin_touch(k);
    if (touch.press_un < threshold_un_) continue;
    auto at = static_cast<size_t>(list.n_listed++);  // strongest first
    for (; at > 0 && list.touch[at - 1].press_un < touch.press_un; --at) list.touch[at] = list.touch[at - 1];
    list.touch[at] = touch;
  }
  list.n_found = list.n_listed;
  return list;
}

}  // namespace ruffini
