#include "solve/steady_field.h"

#include <algorithm>
#include <cstdlib>

#include "solve/block_float.h"

namespace ruffini {
namespace {

using namespace block_float;

constexpr int kForceFraction = 4;
constexpr int kUnitFraction = 14;                   // of b
constexpr int64_t kMaxChange = int64_t{1} << 20;    // of f - m
constexpr int64_t kChangeLimit = int64_t{1} << 32;  // of g
constexpr int64_t kMaxEvidence = int64_t{1} << 40;  // of b
constexpr int64_t kMaxSurprise = int64_t{1} << 20;  // of b - B: 64 standard deviations

int64_t rounded_quotient(int64_t x, int64_t n) { return floor_div(2 * x + n, 2 * n); }

// numerator / denominator, and its sign.
struct Amplitude {
  Quotient size;
  bool is_negative = false;

  Amplitude(int64_t numerator, int64_t denominator)
      : size(numerator == 0 || denominator <= 0 ? Quotient{} : quotient(std::abs(numerator), denominator, 0)),
        is_negative(numerator < 0) {}

  [[nodiscard]] int64_t times(int64_t value) const {
    return is_negative ? -scaled(value, size, 0) : scaled(value, size, 0);
  }
};

void subtract(int64_t& value, int64_t part) { value = std::clamp(value - part, -kChangeLimit, kChangeLimit); }

}  // namespace

SteadyField::SteadyField(GridSize nodes, std::span<const NodePlace> places, int frames)
    : places_(places.begin(), places.end()), frames_(frames), components_(nodes), history_(places.size()) {
  contact_.reserve(places.size());
}

void SteadyField::forget() { std::fill(history_.begin(), history_.end(), History{}); }

void SteadyField::run(std::span<const uint8_t> mask, std::span<const int64_t> evidence, std::span<NodeForce> force,
                      SaturationCounter& saturations) {
  const std::span<const uint16_t> label = components_.find(mask);
  for (size_t i = 0; i < history_.size(); ++i) {
    if (mask[i] == 0) history_[i].n = 0;
  }
  for (int c = 1; c <= components_.count(); ++c) {
    gather(static_cast<uint16_t>(c), label, evidence, force);
    int n = 1;
    if (const int before = c <= kMaxContacts ? steady_frames() : 0; before > 0 && place_patterns(force)) {
      n = std::min(before + 1, frames_);
      take_out_shear();
      take_out_pressure();
    }
    update(n, force, saturations);
  }
}

void SteadyField::gather(uint16_t contact, std::span<const uint16_t> label, std::span<const int64_t> evidence,
                         std::span<const NodeForce> force) {
  contact_.clear();
  size_t at = 0;  // in evidence
  for (uint32_t node = 0; node < label.size(); ++node) {
    if (label[node] == 0) continue;
    if (label[node] == contact) {
      Touched t{.node = node};
      const NodeForce& f = force[node];
      const std::array<int64_t, 3> now = {f.x, f.y, f.z};
      const History& h = history_[node];
      for (size_t a = 0; a < 3; ++a) {
        t.evidence[a] = std::clamp(evidence[at + a], -kMaxEvidence, kMaxEvidence);
        if (h.n > 0) t.change[a] = now[a] * (int64_t{1} << kForceFraction) - h.force[a];
      }
      contact_.push_back(t);
    }
    at += 3;
  }
}

int SteadyField::steady_frames() const {
  int64_t n = frames_;
  size_t n_known = 0;
  for (const Touched& t : contact_) {
    const History& h = history_[t.node];
    if (h.n == 0) continue;
    ++n_known;
    n = std::min<int64_t>(n, h.n);
  }
  if (4 * n_known < 3 * contact_.size() || contact_.size() > kMaxNodes) return 0;
  const int64_t most = kLimit * kLimit * (n + 1) * (int64_t{1} << (2 * kUnitFraction));
  for (const Touched& t : contact_) {
    const History& h = history_[t.node];
    if (h.n == 0) continue;
    for (size_t a = 0; a < 3; ++a) {
      const int64_t surprise = std::clamp(t.evidence[a] - h.evidence[a], -kMaxSurprise, kMaxSurprise);
      if (n * surprise * surprise > most || std::abs(t.change[a]) > kMaxChange) return 0;
    }
  }
  return static_cast<int>(n);
}

bool SteadyField::place_patterns(std::span<const NodeForce> force) {
  int64_t largest = 0;
  for (Touched& t : contact_) {
    t.pressure = std::max<int64_t>(-int64_t{force[t.node].z}, 0);
    largest = std::max(largest, t.pressure);
  }
  const int pressure_shift = shift_for(largest);
  int64_t total = 0;
  int64_t moment_x = 0;
  int64_t moment_y = 0;
  for (Touched& t : contact_) {
    t.pressure = to_16(t.pressure, pressure_shift);
    total += t.pressure;
    moment_x += t.pressure * places_[t.node].x_um;
    moment_y += t.pressure * places_[t.node].y_um;
  }
  if (total == 0) return false;
  largest = 0;
  for (Touched& t : contact_) {
    t.x = places_[t.node].x_um - floor_div(moment_x, total);
    t.y = places_[t.node].y_um - floor_div(moment_y, total);
    largest = std::max({largest, std::abs(t.x), std::abs(t.y)});
  }
  const int place_shift = shift_for(largest);
  for (Touched& t : contact_) {
    t.x = to_16(t.x, place_shift);
    t.y = to_16(t.y, place_shift);
  }
  return true;
}

// Force along x and y, then the moment about z.
void SteadyField::take_out_shear() {
  int64_t pressure = 0;
  std::array<int64_t, 2> sum{};
  for (const Touched& t : contact_) {
    pressure += t.pressure;
    sum[0] += t.change[0];
    sum[1] += t.change[1];
  }
  const Amplitude along_x(sum[0], pressure);
  const Amplitude along_y(sum[1], pressure);
  int64_t twist = 0;
  int64_t spread = 0;
  for (Touched& t : contact_) {
    subtract(t.change[0], along_x.times(t.pressure));
    subtract(t.change[1], along_y.times(t.pressure));
    twist += t.x * t.change[1] - t.y * t.change[0];
    spread += t.pressure * (t.x * t.x + t.y * t.y);
  }
  const Amplitude turn(twist, spread);
  for (Touched& t : contact_) {
    subtract(t.change[0], turn.times(-t.pressure * t.y));
    subtract(t.change[1], turn.times(t.pressure * t.x));
  }
}

// Force along z, then the moments about the two axes of a and c: a is the wider of x and y, c the other one less
// what goes with a, so that q a has no moment about c's axis and q c none about a's.
void SteadyField::take_out_pressure() {
  int64_t pressure = 0;
  int64_t sum = 0;
  int64_t spread_x = 0;
  int64_t spread_y = 0;
  int64_t mixed = 0;
  for (const Touched& t : contact_) {
    pressure += t.pressure;
    sum += t.change[2];
    spread_x += t.pressure * t.x * t.x;
    spread_y += t.pressure * t.y * t.y;
    mixed += t.pressure * t.x * t.y;
  }
  const bool is_wider_along_x = spread_x >= spread_y;
  const Amplitude along_z(sum, pressure);
  const Amplitude shared(mixed, std::max(spread_x, spread_y));
  const auto wide = [&](const Touched& t) { return is_wider_along_x ? t.x : t.y; };
  const auto narrow = [&](const Touched& t) { return (is_wider_along_x ? t.y : t.x) - shared.times(wide(t)); };
  int64_t wide_moment = 0;
  int64_t narrow_moment = 0;
  int64_t narrow_spread = 0;
  for (Touched& t : contact_) {
    subtract(t.change[2], along_z.times(t.pressure));
    wide_moment += wide(t) * t.change[2];
    narrow_moment += narrow(t) * t.change[2];
    narrow_spread += t.pressure * narrow(t) * narrow(t);
  }
  const Amplitude along_wide(wide_moment, std::max(spread_x, spread_y));
  const Amplitude along_narrow(narrow_moment, narrow_spread);
  for (Touched& t : contact_) {
    subtract(t.change[2], along_wide.times(t.pressure * wide(t)));
    subtract(t.change[2], along_narrow.times(t.pressure * narrow(t)));
  }
}

void SteadyField::update(int n, std::span<NodeForce> force, SaturationCounter& saturations) {
  std::array<int64_t, 3> rounding{};
  size_t strongest = contact_[0].node;
  for (const Touched& t : contact_) {
    NodeForce& f = force[t.node];
    History& h = history_[t.node];
    if (f.z < force[strongest].z) strongest = t.node;
    const std::array<int32_t*, 3> axes = {&f.x, &f.y, &f.z};
    for (size_t a = 0; a < 3; ++a) {
      const int64_t now = *axes[a];
      const int64_t more = h.n > 0 ? rounded_quotient(t.evidence[a] - h.evidence[a], n) : 0;
      h.evidence[a] = h.n > 0 ? h.evidence[a] + more : t.evidence[a];
      h.force[a] = now * (int64_t{1} << kForceFraction);
      if (n == 1) continue;
      h.force[a] -= t.change[a] - rounded_quotient(t.change[a], n);
      *axes[a] = saturate_raw<int32_t>(round_shift(h.force[a], kForceFraction), saturations);
      rounding[a] += now - *axes[a];
    }
    h.n = n;
  }
  if (n == 1) return;
  NodeForce& f = force[strongest];
  const std::array<int32_t*, 3> axes = {&f.x, &f.y, &f.z};
  for (size_t a = 0; a < 3; ++a) {
    *axes[a] = saturate_raw<int32_t>(*axes[a] + rounding[a], saturations);
    history_[strongest].force[a] += rounding[a] * (int64_t{1} << kForceFraction);
  }
}

}  // namespace ruffini
