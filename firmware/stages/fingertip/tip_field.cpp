#include "stages/fingertip/tip_field.h"

#include <algorithm>
#include <cstdlib>
#include <string>

#include "solve/node_sigma.h"

namespace ruffini {
namespace {

constexpr int64_t kOne = int64_t{1} << TipField::kUnit;
constexpr int64_t kFloor = (1 << 15) / 20;       // of the sum of kernels, Q15
constexpr int64_t kMaxShift = int64_t{1} << 24;  // of a marker, Q16 px
constexpr int64_t kMaxMoved = int64_t{1} << 18;  // 16 mm
constexpr int32_t kMaxGain = 1 << 24;
constexpr int64_t kPlaceWeight = 8'000;  // 500 um
constexpr int64_t kMaxApart = 1 << 13;   // of the contradiction, Q16 px
// Keeps sum K v over all pins, and M d, within 63 bits.
static_assert(TipField::kMaxPins * (int64_t{1} << 15) * kMaxMoved * 2 < int64_t{1} << 62);
static_assert(4 * int64_t{kMaxGain} * kMaxShift < int64_t{1} << 62);
static_assert(4 * kMaxShift * kMaxShift < int64_t{1} << 62);

Error refused(const char* what) {
  return {ErrorKind::kBadInput,
          "calibration file: " + std::string(what) + ": make it again with cal fit --only fingertip"};
}

bool are_within(std::span<const int32_t> values, int64_t limit) {
  return std::all_of(values.begin(), values.end(), [&](int32_t v) { return v >= -limit && v <= limit; });
}

// Shortest rotation from c to (0, 0, 1). Precondition: c_z > -1.
TipField::Matrix turn_to_top(const TipField::Vector& c) {
  const auto part = [&](int i, int j) { return floor_div(c[i] * c[j] + (kOne + c[2]) / 2, kOne + c[2]); };
  return TipField::Matrix{
      {kOne - part(0, 0), -part(0, 1), -c[0]}, {-part(0, 1), kOne - part(1, 1), -c[1]}, {c[0], c[1], c[2]}};
}

}  // namespace

Result<TipField> TipField::load(const Calibration& c) {
  const Tensor* const normal = c.tensor("fingertip.normal");
  const Tensor* const place = c.tensor("fingertip.place");
  if (normal == nullptr || normal->shape.empty() || normal->shape[0] < 1 || normal->shape[0] > kMaxPins) {
    return refused("fingertip.normal is missing or of too many pins");
  }
  if (place == nullptr || place->shape.empty() || place->shape[0] < 1 || place->shape[0] > kMaxPlaces) {
    return refused("fingertip.place is missing or too long");
  }
  const int64_t n = normal->shape[0], g = place->shape[0];
  const auto read = [&](const char* name, const std::vector<int64_t>& shape) {
    return c.tensor(name, Tensor::Type::kI32, shape);
  };
  const auto rest = read("fingertip.rest", {kEyes, n, 2});
  const auto normals = read("fingertip.normal", {n, 3});
  const auto gain = read("fingertip.gain", {static_cast<int64_t>(Eyes::kCount), n, 3, 4});
  const auto places = read("fingertip.place", {g, 3});
  const auto kernel = read("fingertip.kernel", {kKernelSteps});
  const auto gates = read("fingertip.gate", {2});
  for (const auto* each : {&rest, &normals, &gain, &places, &kernel, &gates}) {
    if (!*each) return each->error();
  }
  const auto r = rest.value()->as<int32_t>(), v = normals.value()->as<int32_t>(), m = gain.value()->as<int32_t>();
  const auto at = places.value()->as<int32_t>(), k = kernel.value()->as<int32_t>(), t = gates.value()->as<int32_t>();
  if (!are_within(r, 1 << 22) || !are_within(v, kOne) || !are_within(m, kMaxGain) || !are_within(at, kOne) ||
      !are_within(k, 1 << 15) || *std::min_element(k.begin(), k.end()) < 0 || t[0] < 1 || t[0] > 1 << 14 || t[1] < 1 ||
      t[1] > 1 << 16) {
    return refused("a number of fingertip.* is out of range");
  }
  TipField out;
  out.pin_.resize(static_cast<size_t>(n));
  const auto n_values = static_cast<size_t>(n);
  for (size_t p = 0; p < n_values; ++p) {
    Pin& pin = out.pin_[p];
    for (size_t eye = 0; eye < kEyes; ++eye) {
      pin.rest_q8[eye] = {r[(eye * n_values + p) * 2], r[(eye * n_values + p) * 2 + 1]};
    }
    std::copy_n(v.begin() + static_cast<ptrdiff_t>(3 * p), 3, pin.normal.data());
    for (size_t mode = 0; mode < pin.gain.size(); ++mode) {
      std::copy_n(m.begin() + static_cast<ptrdiff_t>(12 * (mode * n_values + p)), 12, pin.gain[mode].data());
    }
    pin.still = still_of(pin.gain[static_cast<size_t>(Eyes::kBoth)]);
  }
  for (size_t i = 0; i < static_cast<size_t>(g); ++i) out.place_.push_back({at[3 * i], at[3 * i + 1], at[3 * i + 2]});
  out.kernel_.assign(k.begin(), k.end());
  out.features_.resize(3 * out.place_.size() + 2);
  out.gate_q8_ = t[0];
  out.min_press_ = t[1];
  return out;
}

// Index of the marker that rests nearest, within the gate; -1: none.
int TipField::nearest(std::span<const Marker> markers, const std::array<int64_t, 2>& place_q8, int64_t gate_q8) {
  int best = -1;
  int64_t limit2 = gate_q8 * gate_q8;
  for (size_t i = 0; i < markers.size(); ++i) {
    if (markers[i].is_absent) continue;
    const int64_t dx = (markers[i].rest_x.raw() >> 8) - place_q8[0];
    const int64_t dy = (markers[i].rest_y.raw() >> 8) - place_q8[1];
    if (dx * dx + dy * dy >= limit2) continue;
    limit2 = dx * dx + dy * dy;
    best = static_cast<int>(i);
  }
  return best;
}

void TipField::learn(std::span<const Marker> markers) {
  const size_t half = markers.size() / kEyes;
  for (Pin& pin : pin_) {
    for (size_t eye = 0; eye < kEyes; ++eye) {
      const int found = nearest(markers.subspan(eye * half, half), pin.rest_q8[eye], gate_q8_);
      pin.marker[eye] = found < 0 ? -1 : found + static_cast<int>(eye * half);
    }
  }
}

int TipField::n_pins_there(Eyes eyes) const {
  return static_cast<int>(std::count_if(pin_.begin(), pin_.end(), [&](const Pin& pin) { return pin.is_there(eyes); }));
}

bool TipField::find_middle() {
  int64_t most = 0;
  for (const Pin& pin : pin_) {
    if (pin.is_used) most = std::max(most, -round_shift(pin.moved.dot(pin.normal), kUnit));
  }
  if (most < min_press_) return false;
  const int64_t floor = most * 77 >> 8;
  Vector sum = Vector::Zero();
  for (const Pin& pin : pin_) {
    if (!pin.is_used) continue;
    sum += std::max<int64_t>(-round_shift(pin.moved.dot(pin.normal), kUnit) - floor, 0) * pin.normal;
  }
  while (sum.cwiseAbs().maxCoeff() >= int64_t{1} << 30) {
    for (int64_t& each : sum) each = round_shift(each, 1);
  }
  const int64_t length = std::max<int64_t>(floor_sqrt(sum.squaredNorm()), 1);
  for (int i = 0; i < 3; ++i) middle_[i] = floor_div(sum[i] * kOne * 2 + length, 2 * length);
  return middle_[2] > 0;
}

TipField::Vector TipField::at(const Vector& g) const {
  Vector sum = Vector::Zero();
  int64_t weight = kFloor;
  for (const Pin& pin : pin_) {
    if (!pin.is_used) continue;
    const int64_t step = (pin.turned - g).squaredNorm() >> 13;  // of Q28
    if (step >= kKernelSteps) continue;
    const int64_t k = kernel_[static_cast<size_t>(step)];
    weight += k;
    sum += k * pin.moved;
  }
  for (int64_t& each : sum) each = floor_div(2 * each + weight, 2 * weight);
  return sum;
}

void TipField::sample() {
  for (Pin& pin : pin_) {
    pin.moved = rounded(turn_ * pin.moved);
    pin.turned = rounded(turn_ * pin.normal);
  }
  auto out = features_.begin();
  for (const Vector& g : place_) {
    for (const int64_t each : at(g)) *out++ = static_cast<int32_t>(each);
  }
  for (int i = 0; i < 2; ++i) *out++ = static_cast<int32_t>(round_shift(middle_[i] * kPlaceWeight, kUnit));
}

// Vector perpendicular to the rows of M: signed determinants of three of its columns.
TipField::Shifts TipField::still_of(Gain m) {
  for (int64_t largest = m.cwiseAbs().maxCoeff(); largest >= 1 << 19; largest >>= 1) {
    for (int64_t& each : m.reshaped()) each >>= 1;
  }
  Shifts n;
  for (int out = 0; out < 4; ++out) {
    const std::array<int, 3> c{out > 0 ? 0 : 1, out > 1 ? 1 : 2, out > 2 ? 2 : 3};
    const auto pair = [&](size_t i, size_t j) { return m(1, c[i]) * m(2, c[j]) - m(1, c[j]) * m(2, c[i]); };
    n[out] = (m(0, c[0]) * pair(1, 2) - m(0, c[1]) * pair(0, 2) + m(0, c[2]) * pair(0, 1)) * (out % 2 == 0 ? 1 : -1);
  }
  for (int64_t most = n.cwiseAbs().maxCoeff(); most >= 1 << 29; most >>= 1) {
    for (int64_t& each : n) each >>= 1;
  }
  const int64_t length = std::max<int64_t>(floor_sqrt(n.squaredNorm()), 1);
  for (int64_t& each : n) each = floor_div(each * kOne, length);
  return n;
}

bool TipField::is_contradicted(const Pin& pin, const Shifts& shift) {
  return std::abs(round_shift(pin.still.dot(shift), kUnit)) > kMaxApart + floor_sqrt(shift.squaredNorm()) / 32;
}

void TipField::move(Pin& pin, std::span<const Marker> markers, Eyes eyes) {
  pin.moved.setZero();
  pin.is_used = pin.is_there(eyes);
  if (!pin.is_used) return;
  std::array<int64_t, 4> seen{};
  bool are_both_sure = true;
  for (size_t eye = 0; eye < kEyes; ++eye) {
    const bool is_asked = eyes != (eye == 0 ? Eyes::kRight : Eyes::kLeft);
    const bool is_confident = pin.marker[eye] >= 0 && markers[static_cast<size_t>(pin.marker[eye])].is_confident();
    are_both_sure = are_both_sure && is_confident;
    pin.is_used = pin.is_used && (is_confident || !is_asked);
    if (!is_confident) continue;
    const Marker& m = markers[static_cast<size_t>(pin.marker[eye])];
    seen[2 * eye] = std::clamp<int64_t>(m.displacement_x.raw(), -kMaxShift, kMaxShift);
    seen[2 * eye + 1] = std::clamp<int64_t>(m.displacement_y.raw(), -kMaxShift, kMaxShift);
  }
  const Shifts shift(seen.data());
  if (are_both_sure && is_contradicted(pin, shift)) {
    pin.is_used = false;
    ++n_contradicted_;
  }
  if (!pin.is_used) return;
  pin.moved = pin.gain[static_cast<size_t>(eyes)] * shift;
  for (int64_t& each : pin.moved) each = std::clamp(round_shift(each, 20), -kMaxMoved, kMaxMoved);
}

bool TipField::run(std::span<const Marker> markers, Eyes eyes) {
  n_contradicted_ = 0;
  for (Pin& pin : pin_) move(pin, markers, eyes);
  if (!find_middle()) return false;
  turn_ = turn_to_top(middle_);
  sample();
  return true;
}

}  // namespace ruffini
