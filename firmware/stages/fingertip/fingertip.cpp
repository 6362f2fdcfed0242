#include "stages/fingertip/fingertip.h"

#include <algorithm>
#include <cstdlib>
#include <string>

#include "base/angle.h"
#include "solve/node_sigma.h"

namespace ruffini {
namespace {

enum Quantity : size_t { kForce, kWay, kX, kY, kTiltX, kTiltY, kSide };
constexpr int64_t kSureArea = 5;  // an area is reported if it is this many times its deviation
constexpr int64_t kMillion = 1'000'000;
constexpr int64_t kMaxTilt = 900'000;  // of the tool's axis beside the pressed place, 1e-6
// Bounds for arbitrary network outputs of a hostile table: squares and products stay within 63 bits.
constexpr int64_t kMaxValue = int64_t{1} << 30;
constexpr int64_t kMaxSigma = int64_t{1} << 28;
static_assert(kSureArea * 2 * kMaxValue * kMaxSigma < int64_t{1} << 62);
using Vector = TipField::Vector;

// 2^q, linear between whole q, Q16; q within -12 and 8.
int64_t power_of_two_q16(int64_t q_q16) {
  const int64_t q = std::clamp<int64_t>(q_q16, -12 * 65536, 8 * 65536);
  const int64_t whole = q >> 16;
  const int64_t mantissa = 65536 + (q & 65535);
  return whole >= 0 ? mantissa << whole : mantissa >> -whole;
}

int64_t held(int64_t value, int64_t limit, SaturationCounter& saturations) {
  if (value >= -limit && value <= limit) return value;
  ++saturations.count;
  return std::clamp(value, -limit, limit);
}

// Markers of the left eye come first.
std::span<const Marker> of_eye(std::span<const Marker> markers, size_t eye) {
  const size_t n = markers.size() / TipField::kEyes;
  return markers.subspan(eye * n, n);
}

int64_t rounded_div(int64_t top, int64_t bottom) { return floor_div(2 * top + bottom, 2 * bottom); }

int64_t root_left(int64_t a, int64_t b) {
  return std::max<int64_t>(floor_sqrt(std::max<int64_t>(kMillion * kMillion - a * a - b * b, 0)), 1);
}

}  // namespace

Result<Fingertip> Fingertip::load(const Calibration& c) {
  auto field = TipField::load(c);
  if (!field) return field.error();
  Fingertip out(std::move(field).value());
  constexpr auto kModes = static_cast<size_t>(Eyes::kCount);
  for (size_t mode = 0; mode < kModes; ++mode) {
    auto net = TipNet::load(c, mode, kModes, out.field_.n_features(), 2 * kQuantities);
    if (!net) return net.error();
    out.nets_.push_back(std::move(net).value());
  }
  auto area = TipArea::load(c);
  if (!area) return area.error();
  out.area_ = std::move(area).value();
  const auto n = static_cast<int64_t>(kQuantities);
  const auto zero = c.tensor("fingertip.zero", Tensor::Type::kI32, {n});
  const auto scale = c.tensor("fingertip.scale", Tensor::Type::kI32, {n});
  const auto trust = c.tensor("fingertip.trust", Tensor::Type::kI32, {static_cast<int64_t>(kModes), n});
  const auto most = c.integer("fingertip.most_un", 1, 1'000'000'000);
  for (const auto* each : {&zero, &scale, &trust}) {
    if (!*each) return each->error();
  }
  if (!most) return most.error();
  out.max_un_ = most.value();
  if (c.tensor("fingertip.rim") != nullptr) {
    const auto rim = c.tensor("fingertip.rim", Tensor::Type::kI32, {2});
    if (!rim) return rim.error();
    const auto at_max = rim.value()->as<int32_t>();
    constexpr int32_t kMostRim = 6 << 16;  // px Q16
    const auto [least, largest] = std::minmax(at_max[0], at_max[1]);
    if (least < 0 || largest > kMostRim) {
      return Error{ErrorKind::kBadInput,
                   "calibration file: fingertip.rim is out of range: make it again with cal fit --only fingertip"};
    }
    out.rim_.fill(RimMotion({.shift_q16 = at_max[0], .zoom_q16 = at_max[1]}));
  }
  const auto z = zero.value()->as<int32_t>(), s = scale.value()->as<int32_t>(), t = trust.value()->as<int32_t>();
  for (size_t i = 0; i < kQuantities; ++i) {
    if (std::abs(int64_t{z[i]}) > 1 << 24 || s[i] < 1 || s[i] > 1 << 24) {
      return Error{
          ErrorKind::kBadInput,
          "calibration file: fingertip.zero or .scale is out of range: make it again with cal fit --only fingertip"};
    }
    out.zero_[i] = z[i];
    out.scale_[i] = s[i];
  }
  for (size_t mode = 0; mode < kModes; ++mode) {
    Numbers& own = out.trust_q8_.emplace_back();
    for (size_t i = 0; i < kQuantities; ++i) own[i] = std::clamp<int64_t>(t[mode * kQuantities + i], 1, 1 << 20);
  }
  return out;
}

void Fingertip::rotate_back(const Numbers& value, TipTouch& touch) const {
  int64_t tx = std::clamp(value[kTiltX], -kMaxTilt, kMaxTilt);
  int64_t ty = std::clamp(value[kTiltY], -kMaxTilt, kMaxTilt);
  if (const int64_t tilt = floor_sqrt(tx * tx + ty * ty); tilt > kMaxTilt) {
    tx = rounded_div(tx * kMaxTilt, tilt);
    ty = rounded_div(ty * kMaxTilt, tilt);
  }
  const int64_t tz = root_left(tx, ty);
  const Vector t = TipField::rounded(field_.turn().transpose() * Vector(tx, ty, tz));
  touch.axis_1e6 = {t[0], t[1], t[2]};
  const int64_t cos_roll = root_left(t[1], 0);
  touch.roll_urad = atan2_urad(-t[1], cos_roll);
  touch.pitch_urad = atan2_urad(t[0], t[2]);
  // The tool's position is perpendicular to its axis.
  const int64_t along = rounded_div(-(value[kX] * tx + value[kY] * ty), tz);
  const Vector at = TipField::rounded(field_.turn().transpose() * Vector(value[kX], value[kY], along));
  const auto part = [&](int64_t of) { return std::clamp(rounded_div(of * kMillion, cos_roll), -kMillion, kMillion); };
  const int64_t sin_pitch = part(t[0]), cos_pitch = part(t[2]);
  const int64_t level = rounded_div(sin_pitch * at[0] + cos_pitch * at[2], kMillion);
  touch.x_um = rounded_div(cos_pitch * at[0] - sin_pitch * at[2], kMillion);
  touch.y_um = rounded_div(cos_roll * at[1] - t[1] * level, kMillion);
}

void Fingertip::learn(std::span<const Marker> markers) {
  field_.learn(markers);
  for (size_t eye = 0; eye < rim_.size(); ++eye) rim_[eye].learn(of_eye(markers, eye));
}

TipTouch Fingertip::run(std::span<const Marker> markers, Eyes eyes, SaturationCounter& saturations) {
  TipTouch touch = estimate(markers, eyes, saturations);
  for (size_t eye = 0; eye < rim_.size(); ++eye) {
    const bool is_blind = eyes == (eye == 0 ? Eyes::kRight : Eyes::kLeft);
    const bool has_moved = !is_blind && rim_[eye].has_moved(of_eye(markers, eye), touch.force_un, max_un_);
    touch.has_camera_moved = touch.has_camera_moved || has_moved;
  }
  return touch;
}

TipTouch Fingertip::estimate(std::span<const Marker> markers, Eyes eyes, SaturationCounter& saturations) {
  TipTouch touch;
  if (!field_.run(markers, eyes)) return touch;
  TipNet& net = nets_[static_cast<size_t>(eyes)];
  const std::span<const int64_t> out = net.run(field_.features(), saturations);
  Numbers value, sigma;
  for (size_t i = 0; i < kQuantities; ++i) {
    value[i] = held(zero_[i] + round_shift(out[i] * scale_[i], 16), kMaxValue, saturations);
    const int64_t own = round_shift(scale_[i] * power_of_two_q16(out[kQuantities + i]), 16);
    const int64_t trusted = round_shift(own * trust_q8_[static_cast<size_t>(eyes)][i], 8);
    sigma[i] = std::max<int64_t>(held(trusted, kMaxSigma, saturations), 1);
  }
  touch.is_touched = true;
  touch.is_known = net.is_known();
  touch.force_un = std::max<int64_t>(value[kForce], 0);
  touch.is_in_range = touch.force_un <= max_un_;
  touch.travel_um = value[kWay];
  // Positions and angles are rotated in pairs, so each pair has one deviation.
  const auto both = [&](size_t a, size_t b) { return floor_sqrt((sigma[a] * sigma[a] + sigma[b] * sigma[b]) / 2); };
  const int64_t place = both(kX, kY), tilt = both(kTiltX, kTiltY);
  touch.sigma = {sigma[kForce], sigma[kWay], place, place, tilt, tilt, 2 * std::abs(value[kSide]) * sigma[kSide]};
  const int64_t area_um2 = value[kSide] * value[kSide];
  if (kSureArea * touch.sigma[6] <= area_um2) touch.area_um2 = area_um2;
  std::copy_n(field_.middle().data(), 3, touch.place_q14.begin());
  rotate_back(value, touch);
  if (area_ && eyes == Eyes::kBoth) estimate_areas(touch);
  return touch;
}

// Uses the table's face area if the network's is too uncertain and the table's is not.
void Fingertip::estimate_areas(TipTouch& touch) {
  const TipAreas areas = area_->run(field_, Vector(touch.axis_1e6.data()), touch.force_un, touch.travel_um);
  touch.flat_area_um2 = areas.flat_area_um2;
  touch.flat_area_sigma_um2 = areas.flat_area_sigma_um2;
  if (touch.area_um2 != 0 || !touch.is_known || areas.face_um2 == 0 ||
      kSureArea * areas.face_sigma_um2 > areas.face_um2)
    return;
  touch.area_um2 = areas.face_um2;
  touch.sigma[6] = areas.face_sigma_um2;
}

}  // namespace ruffini
