#include "solve/relaxation.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr int64_t kOne = int64_t{1} << 30;
constexpr uint64_t kLongest = 24;  // number of time constants after which exp is below half a step
constexpr int kPartFraction = 20;
constexpr int64_t kWhole = int64_t{1} << kPartFraction;
constexpr int64_t kMaxTimeMs = 1'000'000;
constexpr int64_t kMaxForce = int64_t{1} << 25;  // force steps

int64_t times_q20(int64_t a, int64_t part_q20) { return round_shift(a * part_q20, kPartFraction); }

int64_t times_q30(int64_t a, int64_t b) { return round_shift(a * b, 30); }

}  // namespace

// exp(-x) = exp(-x / 2^n)^(2^n); the inner one by its series to fifth order, with x / 2^n <= 1/8.
int64_t relaxed_part_q20(uint64_t duration_us, int64_t time_us) {
  const auto time = static_cast<uint64_t>(time_us);
  if (duration_us >= kLongest * time) return kWhole;
  const auto x = static_cast<int64_t>((duration_us << 30) / time);
  int halvings = 0;
  while ((x >> halvings) > kOne / 8) ++halvings;
  const int64_t z = x >> halvings;
  int64_t e = kOne - z / 5;
  for (const int64_t n : {4, 3, 2, 1}) e = kOne - times_q30(z, e) / n;
  for (int i = 0; i < halvings; ++i) e = times_q30(e, e);
  return round_shift(kOne - e, 30 - kPartFraction);
}

Result<Relaxation> Relaxation::load(const Calibration& calibration, int n_nodes) {
  auto n_terms = calibration.integer("relaxation.terms", 1, kMaxTerms);
  if (!n_terms) return n_terms.error();
  const auto n = static_cast<int>(n_terms.value());
  auto part = calibration.tensor("relaxation.part", Tensor::Type::kI32, {n});
  if (!part) return part.error();
  auto time = calibration.tensor("relaxation.time_ms", Tensor::Type::kI32, {n});
  if (!time) return time.error();
  Relaxation out;
  out.before_.resize(static_cast<size_t>(n_nodes));
  int64_t loss = 0;
  for (size_t i = 0; i < static_cast<size_t>(n); ++i) {
    const int64_t part_q20 = part.value()->as<int32_t>()[i];
    const int64_t time_ms = time.value()->as<int32_t>()[i];
    loss += part_q20;
    if (part_q20 < 0 || loss >= kWhole || time_ms <= 0 || time_ms > kMaxTimeMs) {
      return Error{ErrorKind::kBadInput,
                   "calibration file: the parts that relax must be positive and sum below 1, their times 1 to 1000000 "
                   "ms: make it again"};
    }
    out.terms_.push_back({part_q20, 1000 * time_ms, 0, std::vector<std::array<int64_t, 3>>(out.before_.size())});
  }
  return out;
}

void Relaxation::forget() {
  last_us_ = 0;
  std::fill(before_.begin(), before_.end(), std::array<int64_t, 3>{});
  for (Term& t : terms_) std::fill(t.state.begin(), t.state.end(), std::array<int64_t, 3>{});
}

void Relaxation::run(uint64_t capture_us, std::span<const uint8_t> mask, std::span<NodeForce> force,
                     SaturationCounter& saturations) {
  const uint64_t duration_us = last_us_ == 0 || capture_us <= last_us_ ? 0 : capture_us - last_us_;
  last_us_ = std::max(capture_us, last_us_);
  for (Term& t : terms_) t.step_q20 = relaxed_part_q20(duration_us, t.time_us);
  for (size_t node = 0; node < force.size(); ++node) {
    NodeForce& f = force[node];
    const bool is_touched = mask[node] != 0;
    for (int32_t* axis : {&f.x, &f.y, &f.z}) {
      const auto c = static_cast<size_t>(axis == &f.x ? 0 : axis == &f.y ? 1 : 2);
      *axis = static_cast<int32_t>(step(node, c, is_touched, *axis, saturations));
    }
  }
}

int64_t Relaxation::step(size_t node, size_t axis, bool is_touched, int64_t force, SaturationCounter& saturations) {
  const int64_t held = std::clamp(force, -kMaxForce, kMaxForce);
  if (held != force) ++saturations.count;
  int64_t dent = 0;
  for (const Term& t : terms_) dent += times_q20(t.state[node][axis], t.part_q20);
  const int64_t elastic = is_touched ? held * (int64_t{1} << kFraction) : dent;
  const int64_t mean = round_shift(elastic + before_[node][axis], 1);
  before_[node][axis] = elastic;
  int64_t lost = 0;
  for (Term& t : terms_) {
    t.state[node][axis] += times_q20(mean - t.state[node][axis], t.step_q20);
    lost += times_q20(t.state[node][axis], t.part_q20);
  }
  return is_touched ? round_shift(elastic - lost, kFraction) : 0;
}

}  // namespace ruffini
