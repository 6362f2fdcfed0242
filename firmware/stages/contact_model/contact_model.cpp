#include "stages/contact_model/contact_model.h"

#include <algorithm>
#include <bit>
#include <cstdlib>
#include <utility>

namespace ruffini {
namespace {

constexpr int kShapeFraction = 14;
constexpr int kWhiteShift = 20;
constexpr int64_t kMaxLost1e3 = 250;
constexpr int64_t kStraightPart = 10;    // F_t <= F_n / this
constexpr int64_t kBackUm = 50;          // less deep than before by more than this: the object is retreating
constexpr int64_t kMaxFrames = 1'024;    // per press: keeps (n x y) 4096 within 63 bits
constexpr int64_t kMaxDepthUm = 20'000;  // also limits the square root of an area
constexpr int64_t kMaxShoreQ4 = 100 << 4;
constexpr int64_t kMaxPressurePa = 100'000'000;
constexpr int64_t kMaxWhite = int64_t{1} << 20;  // z Q8
constexpr int64_t kHalfSure = 500;
constexpr int64_t kSlopeOne = 4'096;
constexpr int64_t kMaxKind = 1 << 16;   // Q12; also for fails
constexpr int64_t kMaxSlope = 1 << 16;  // Q12
constexpr int64_t kMaxOdds = 1 << 24;   // Q12, of the table

template <typename T>
Status take(Result<T> loaded, T& part) {
  if (!loaded) return loaded.error();
  part = std::move(loaded).value();
  return Unit{};
}

// log2, Q10, of the weighted mean index of the circle, times 1024.
int64_t radius_q10(const Profile& profile) {
  int64_t sum = 0;
  int64_t moment = 0;
  for (size_t i = 0; i < Profile::kRings; ++i) {
    const int64_t out = std::max<int64_t>(profile.radial_q4[i], 0);
    sum += out;
    moment += out * static_cast<int64_t>(i + 1);
  }
  return sum == 0 ? 0 : log2_q10(moment * 1'024 / sum);
}

constexpr size_t index_of(ContactKind kind) { return kind == ContactKind::kHertzian ? 1 : 0; }

}  // namespace

int64_t log2_q10(int64_t x) {
  if (x < 1) return 0;
  const int whole = static_cast<int>(std::bit_width(static_cast<uint64_t>(x))) - 1;
  auto rest = static_cast<uint64_t>(whole > 30 ? x >> (whole - 30) : x << (30 - whole));  // 1 to 2, Q30
  int64_t out = whole;
  for (int bit = 0; bit < 10; ++bit) {
    rest = (rest * rest) >> 30;
    const bool is_two = (rest >> 31) != 0;
    out = 2 * out + (is_two ? 1 : 0);
    if (is_two) rest >>= 1;
  }
  return out;
}

Result<ContactModel> ContactModel::load(const Calibration& c) {
  ContactModel out;
  const auto inputs = static_cast<int>(kInputs);
  if (Status s = take(TanhTable::load(c, "contact_model.tanh"), out.tanh_); !s) return s.error();
  if (Status s = take(Perceptron::load(c, "contact_model.size", inputs, kSizes), out.size_); !s) return s.error();
  if (Status s = take(Perceptron::load(c, "contact_model.kind", inputs, 1), out.kind_); !s) return s.error();
  if (Status s = take(Perceptron::load(c, "contact_model.fails", inputs, 1), out.fails_); !s) return s.error();
  if (Status s = take(Perceptron::load(c, "contact_model.planar", inputs, 1), out.hardness_[0]); !s) return s.error();
  if (Status s = take(Perceptron::load(c, "contact_model.hertzian", inputs, 1), out.hardness_[1]); !s) {
    return s.error();
  }
  if (Status s = out.load_strange(c); !s) return s.error();
  if (Status s = out.load_sigma(c); !s) return s.error();
  if (Status s = out.load_odds(c); !s) return s.error();
  const struct {
    const char* key;
    int64_t high;
    int64_t* value;
  } numbers[] = {{"contact_model.most_failing_q12", kMaxKind, &out.max_failing_q12_},
                 {"contact_model.least_fall_q16", 1 << 16, &out.min_fall_q16_},
                 {"contact_model.least_force_un", 1'000'000'000, &out.min_force_un_},
                 {"contact_model.moment_per_flow", 1'000'000'000, &out.moment_per_flow_},
                 {"contact_model.depth_sigma_um", 10'000, &out.depth_sigma_um_}};
  for (const auto& number : numbers) {
    const auto value = c.integer(number.key, 1, number.high);
    if (!value) return value.error();
    *number.value = value.value();
  }
  return out;
}

Status ContactModel::load_strange(const Calibration& c) {
  constexpr auto n = static_cast<int64_t>(Profile::kRings);
  const auto whitening = c.tensor("contact_model.whitening", Tensor::Type::kI32, {n, n});
  if (!whitening) return whitening.error();
  const auto mean = c.tensor("contact_model.mean", Tensor::Type::kI16, {n});
  if (!mean) return mean.error();
  const auto most = c.integer("contact_model.most_strange_q8", 1, 1 << 24);
  if (!most) return most.error();
  whitening_.assign(whitening.value()->as<int32_t>().begin(), whitening.value()->as<int32_t>().end());
  mean_.assign(mean.value()->as<int16_t>().begin(), mean.value()->as<int16_t>().end());
  max_strange_q8_ = most.value();
  return Unit{};
}

Status ContactModel::load_sigma(const Calibration& c) {
  const auto sigma = c.tensor("contact_model.sigma", Tensor::Type::kI32, {2, static_cast<int64_t>(kBands)});
  if (!sigma) return sigma.error();
  const auto values = sigma.value()->as<int32_t>();
  if (std::any_of(values.begin(), values.end(), [](int32_t v) { return v < 1 || v > kMaxShoreQ4; })) {
    return Error{ErrorKind::kBadInput,
                 "calibration file: contact_model.sigma is not within 1/16 to 100 Shore A: make "
                 "it again with `ruffini cal fit --only contact --log`"};
  }
  for (size_t kind = 0; kind < 2; ++kind) {
    std::copy_n(values.begin() + static_cast<ptrdiff_t>(kind * kBands), kBands, sigma_q4_[kind].begin());
  }
  return Unit{};
}

Status ContactModel::load_odds(const Calibration& c) {
  const auto odds = c.tensor("contact_model.odds", Tensor::Type::kI32, {static_cast<int64_t>(odds_q12_.size())});
  if (!odds) return odds.error();
  const auto values = odds.value()->as<int32_t>();
  if (std::any_of(values.begin(), values.end(), [](int32_t v) { return std::abs(int64_t{v}) > kMaxOdds; })) {
    return Error{ErrorKind::kBadInput,
                 "calibration file: contact_model.odds is beyond 4096: make it again with `ruffini cal fit --only "
                 "contact --log`"};
  }
  std::copy(values.begin(), values.end(), odds_q12_.begin());
  return Unit{};
}

void ContactModel::Line::add(int64_t at, int64_t value) {
  x += at;
  y += value;
  x_x += at * at;
  x_y += at * value;
}

int64_t ContactModel::Line::slope(int64_t n, int64_t scale) const {
  const int64_t spread = n * x_x - x * x;
  return spread > 0 ? floor_div((n * x_y - x * y) * scale, spread) : 0;
}

int64_t ContactModel::odds_q12() const {
  const auto held = [&](const Line& line) {
    return std::clamp(line.slope(press_.n, kSlopeOne), -kMaxSlope, kMaxSlope);
  };
  const int64_t told = odds_q12_[1] * floor_div(press_.kind, press_.weight) + odds_q12_[2] * held(press_.force) +
                       odds_q12_[3] * held(press_.radius);
  return odds_q12_[0] + round_shift(told, 12);
}

ContactModel::Inputs ContactModel::inputs_of(const Profile& profile, int64_t press_un) {
  Inputs x{};
  const int64_t size = std::max<int64_t>(profile.size_q4, 1);
  for (size_t i = 0; i < Profile::kRings; ++i) {
    x[i] = floor_div(2 * (profile.radial_q4[i] << kShapeFraction) + size, 2 * size);
  }
  x[Profile::kRings] = log2_q10(size);
  x[Profile::kRings + 1] = log2_q10(press_un / 1'000);
  return x;
}

// Depths are Q12 of the profile's size, areas are given by their square roots in um.
void ContactModel::estimate_size(const Inputs& x, const Profile& profile, SaturationCounter& saturations) {
  std::array<int64_t, kSizes> y{};
  size_.run(tanh_, x, y, saturations);
  const auto limited = [&](int64_t value) {
    const int64_t held = std::clamp<int64_t>(value, 0, kMaxDepthUm);
    if (held != value && value > 0) ++saturations.count;
    return held;
  };
  const auto depth = [&](int64_t ratio_q12) {
    return limited(round_shift(std::clamp<int64_t>(ratio_q12, 0, 1 << 20) * profile.size_q4, 16));
  };
  contact_.gel_depth_um = depth(y[0]);
  contact_.press_depth_um = std::max(depth(y[1]), contact_.gel_depth_um);
  contact_.area_um2 = limited(y[2]) * limited(y[2]);
  contact_.effective_area_um2 = limited(y[3]) * limited(y[3]);
  contact_.depth_sigma_um = depth_sigma_um_;
  contact_.is_over_range = contact_.gel_depth_um > kRangeUm;
}

int64_t ContactModel::strange_q8(const Inputs& x) const {
  constexpr size_t n = Profile::kRings;
  int64_t square = 0;
  for (size_t i = 0; i < n; ++i) {
    int64_t sum = 0;
    for (size_t j = 0; j < n; ++j) sum += whitening_[i * n + j] * (x[j] - mean_[j]);
    const int64_t z_q8 = std::clamp(round_shift(sum, kWhiteShift), -kMaxWhite, kMaxWhite);
    square += z_q8 * z_q8;
  }
  return square / static_cast<int64_t>(n << 8);
}

void ContactModel::accumulate(const Inputs& x, const Profile& profile, const Wrench& wrench,
                              SaturationCounter& saturations) {
  const int64_t depth = contact_.gel_depth_um;
  const bool is_on_the_way_back = depth + kBackUm < press_.deepest_um;
  press_.deepest_um = std::max(press_.deepest_um, depth);
  const int64_t press_mn = -wrench.force_z_un / 1'000;
  const int64_t side_x = wrench.force_x_un / 1'000;
  const int64_t side_y = wrench.force_y_un / 1'000;
  const int64_t most = press_mn / kStraightPart;
  const bool is_straight = side_x * side_x + side_y * side_y <= most * most;
  if (depth < kMinHardnessDepthUm || depth > kMaxHardnessDepthUm || is_on_the_way_back || !is_straight ||
      press_.n >= kMaxFrames) {
    return;
  }
  int64_t kind = 0;
  int64_t fails = 0;
  kind_.run(tanh_, x, {&kind, 1}, saturations);
  fails_.run(tanh_, x, {&fails, 1}, saturations);
  for (size_t k = 0; k < 2; ++k) {
    int64_t shore = 0;
    hardness_[k].run(tanh_, x, {&shore, 1}, saturations);
    press_.shore[k] += depth * std::clamp<int64_t>(shore, 0, kMaxShoreQ4);
  }
  press_.n += 1;
  press_.weight += depth;
  press_.kind += depth * std::clamp(kind, -kMaxKind, kMaxKind);
  press_.fails += depth * std::clamp(fails, -kMaxKind, kMaxKind);
  press_.strange += depth * strange_q8(x);
  const int64_t area = std::max<int64_t>(contact_.effective_area_um2, 1);
  const int64_t pressure_pa = std::min(-wrench.force_z_un * 1'000'000 / area, kMaxPressurePa);
  press_.pressure.add(depth, pressure_pa);
  press_.force.add(x[Profile::kRings], x[Profile::kRings + 1]);
  press_.radius.add(x[Profile::kRings], radius_q10(profile));
}

void ContactModel::estimate_from_press() {
  if (press_.n < kMinFrames) return;
  const int64_t odds = odds_q12();
  contact_.kind = odds > 0 ? ContactKind::kPlanar : ContactKind::kHertzian;
  contact_.confidence_1e3 = kHalfSure + (kHalfSure * tanh_.tanh_q15(std::abs(odds) / 2) >> 15);
  contact_.is_strange =
      press_.strange / press_.weight > max_strange_q8_ || floor_div(press_.fails, press_.weight) > max_failing_q12_;
  const size_t kind = index_of(contact_.kind);
  contact_.shore_q4 = press_.shore[kind] / press_.weight;
  const auto band = static_cast<size_t>(contact_.shore_q4 / (10 << 4));
  contact_.shore_sigma_q4 = sigma_q4_[kind][std::min(band, kBands - 1)];
  contact_.has_hardness = true;
  contact_.stiffness_pa_um = press_.pressure.slope(press_.n, 1);
}

void ContactModel::forget() {
  press_ = {};
  is_interrupted_ = false;
  n_unseen_ = 0;
  seen_us_ = 0;
}

void ContactModel::check_gap(bool is_seen, uint64_t capture_us) {
  n_unseen_ = is_seen ? 0 : std::min(n_unseen_ + 1, kMaxUnseen + 1);
  const bool is_late = is_seen && seen_us_ != 0 && capture_us > seen_us_ + kMaxUnseenUs;
  if (is_late || n_unseen_ > kMaxUnseen) {
    is_interrupted_ = true;
    press_ = {};
  }
  if (is_seen) seen_us_ = capture_us;
}

const ModelledContact& ContactModel::run(const Profile& profile, const Wrench& wrench, bool is_trusted,
                                         uint64_t capture_us, SaturationCounter& saturations) {
  contact_ = {};
  contact_.is_touched = profile.fall_q16 >= min_fall_q16_ && -wrench.force_z_un >= min_force_un_;
  contact_.is_covered = profile.lost_1e3 > kMaxLost1e3;
  const bool is_seen = is_trusted && !contact_.is_covered;
  check_gap(is_seen, capture_us);
  if (!contact_.is_touched) {
    if (is_seen) forget();
    return contact_;
  }
  contact_.mean_flow_um = round_shift(profile.flow_q4, 4);
  contact_.moment_by_flow_unmm = round_shift(profile.flow_q4 * moment_per_flow_, 4);
  inputs_ = inputs_of(profile, -wrench.force_z_un);
  estimate_size(inputs_, profile, saturations);
  if (is_seen && !is_interrupted_ && !contact_.is_over_range) accumulate(inputs_, profile, wrench, saturations);
  estimate_from_press();
  return contact_;
}

}  // namespace ruffini
