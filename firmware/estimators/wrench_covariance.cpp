#include "estimators/wrench_covariance.h"

#include <algorithm>

#include "base/filled.h"
#include "base/fixed.h"
#include "solve/node_sigma.h"

namespace ruffini {
namespace {

constexpr int kFactorFraction = 20;
constexpr int kGrowthFraction = 8;
constexpr int64_t kUmPerMm = 1'000;
constexpr int64_t kMaxUnlisted = 16;  // contacts counted one by one, at most
constexpr int64_t kMaxReading = int64_t{1} << 40;
constexpr int64_t kMaxPlace_um = int64_t{1} << 17;

// Limits of the parameters: sigma of force and moment, lever, factor.
constexpr std::array<int32_t, 4> kLowest = {100, 100, 0, 0};
constexpr std::array<int32_t, 4> kHighest = {1 << 20, 1 << 24, 1 << 20, 1 << 20};

// Rounds half up.
int64_t rounded(int64_t numerator, int64_t denominator) {
  return floor_div(2 * numerator + denominator, 2 * denominator);
}

int64_t clamp_symmetric(int64_t x, int64_t limit = WrenchErrorModel::kMaxSigma) { return std::clamp(x, -limit, limit); }

}  // namespace

void add_outer(WrenchCovariance& sum, const std::array<int64_t, 6>& v, int64_t times) {
  size_t k = 0;
  for (size_t i = 0; i < v.size(); ++i) {
    for (size_t j = i; j < v.size(); ++j, ++k) sum.upper[k] += times * (v[i] * v[j]);
  }
}

TouchedNodes count_touched(std::span<const uint8_t> mask, std::span<const uint8_t> filled) {
  TouchedNodes touched;
  for (size_t i = 0; i < mask.size(); ++i) {
    if (mask[i] == 0) continue;
    ++touched.n;
    touched.n_filled += filled[i] == kNothingFilled ? 0 : 1;
    touched.n_all_filled += filled[i] == kAllFilled ? 1 : 0;
  }
  return touched;
}

Result<WrenchErrorModel> WrenchErrorModel::load(const Calibration& calibration, const PadSettings& pad,
                                                int64_t stiffness_q20) {
  auto tensor = calibration.tensor("support.error_wrench", Tensor::Type::kI32, {kParameters / 2, 2});
  if (!tensor) return tensor.error();
  const std::span<const int32_t> values = tensor.value()->as<int32_t>();
  WrenchErrorModel out;
  out.stiffness_q20_ = stiffness_q20;
  const std::array<std::array<int64_t, 2>*, 4> parts = {&out.contact_.force_un, &out.contact_.moment_un_mm,
                                                        &out.contact_.lever_nm, &out.factor_q20_};
  for (size_t i = 0; i < kParameters; ++i) {
    const size_t row = i / 2;
    if (values[i] < kLowest[row] || values[i] > kHighest[row]) {
      return Error{
          ErrorKind::kBadInput,
          "calibration file: support.error_wrench states no error or one out of range: make the operator again"};
    }
    (*parts[row])[i % 2] = values[i];
  }
  out.half_x_um_ = clamp_symmetric(pad.size_x_um / 2, kMaxPlace_um);
  out.half_y_um_ = clamp_symmetric(pad.size_y_um / 2, kMaxPlace_um);
  return out;
}

// Multiplies the errors that grow with shear (fx, fy, tz) by sqrt(1 + kFilledShear share), those that grow with
// pressure (fz, tx, ty) by sqrt(1 + kFilledNormal share), Q8, rounded down.
WrenchErrorModel::ContactError WrenchErrorModel::scaled_for_filled(const TouchedNodes& touched) const {
  ContactError out = contact_;
  if (touched.n_filled == 0) return out;
  const auto growth_q8 = [&](int64_t n_more) {
    return floor_sqrt(((touched.n + n_more) << (2 * kGrowthFraction)) / touched.n);
  };
  const std::array growth = {growth_q8(kFilledShear * touched.n_filled),
                             growth_q8(kFilledNormal * touched.n_all_filled)};
  for (size_t part = 0; part < growth.size(); ++part) {
    const auto grow = [&](int64_t& sigma) { sigma = round_shift(sigma * growth[part], kGrowthFraction); };
    grow(out.force_un[part]);
    grow(out.moment_un_mm[1 - part]);
    grow(out.lever_nm[1 - part]);
  }
  return out;
}

// Adds the errors of a force at (x, y), whose wrench about the origin is (F, X x F).
void WrenchErrorModel::add_contact(WrenchCovariance& sum, const ContactError& error, const Contact& contact) {
  const int64_t x = clamp_symmetric(contact.center_x_um, kMaxPlace_um);
  const int64_t y = clamp_symmetric(contact.center_y_um, kMaxPlace_um);
  const auto [shear, normal] = error.force_un;
  add_outer(sum, {shear, 0, 0, 0, 0, clamp_symmetric(rounded(-y * shear, kUmPerMm))});
  add_outer(sum, {0, shear, 0, 0, 0, clamp_symmetric(rounded(x * shear, kUmPerMm))});
  add_outer(sum, {0, 0, normal, clamp_symmetric(rounded(y * normal, kUmPerMm)),
                  clamp_symmetric(rounded(-x * normal, kUmPerMm)), 0});
  const int64_t pressing = clamp_symmetric(contact.force_z_un, kMaxReading);
  for (size_t axis = 3; axis < 6; ++axis) {
    const size_t part = axis == 5 ? 1 : 0;
    Vector constant{};
    Vector proportional{};
    constant[axis] = error.moment_un_mm[part];
    proportional[axis] = clamp_symmetric(rounded(error.lever_nm[part] * pressing, kUmPerMm * kUmPerMm));
    add_outer(sum, constant);
    add_outer(sum, proportional);
  }
}

// Their lever is half the pad in both directions.
void WrenchErrorModel::add_unlisted(WrenchCovariance& sum, const ContactError& error, int64_t n_contacts) const {
  const int64_t n = std::min(n_contacts, kMaxUnlisted);
  const auto [shear, normal] = error.force_un;
  const auto [bending, torsion] = error.moment_un_mm;
  const int64_t x_mm = half_x_um_ / kUmPerMm + 1;
  const int64_t y_mm = half_y_um_ / kUmPerMm + 1;
  const Vector each = {shear,
                       shear,
                       normal,
                       std::max(normal * y_mm, bending),
                       std::max(normal * x_mm, bending),
                       std::max(shear * (x_mm + y_mm), torsion)};
  for (size_t i = 0; i < each.size(); ++i) {
    Vector alone{};
    alone[i] = clamp_symmetric(each[i]);
    add_outer(sum, alone, n);
  }
}

WrenchCovariance WrenchErrorModel::run(const Wrench& w, const ContactList& contacts,
                                       const TouchedNodes& touched) const {
  WrenchCovariance sum;
  const ContactError error = scaled_for_filled(touched);
  const auto part = [](int64_t factor, int64_t reading) {
    return clamp_symmetric(round_shift(factor * clamp_symmetric(reading, kMaxReading), kFactorFraction));
  };
  const auto mm = [](int64_t torque_un_um) { return rounded(torque_un_um, kUmPerMm); };
  const auto parts = [&](int64_t shear, int64_t pressure) {
    return Vector{part(shear, w.force_x_un),
                  part(shear, w.force_y_un),
                  part(pressure, w.force_z_un),
                  part(pressure, mm(w.torque_x_un_um)),
                  part(pressure, mm(w.torque_y_un_um)),
                  part(shear, mm(w.torque_z_un_um))};
  };
  add_outer(sum, parts(factor_q20_[0], 0));
  add_outer(sum, parts(0, factor_q20_[1]));
  add_outer(sum, parts(stiffness_q20_, stiffness_q20_));
  for (int i = 0; i < contacts.n_listed; ++i) add_contact(sum, error, contacts.contacts[static_cast<size_t>(i)]);
  if (contacts.n_found == 0) add_contact(sum, error, {});
  if (contacts.n_found > contacts.n_listed) add_unlisted(sum, error, contacts.n_found - contacts.n_listed);
  return sum;
}

}  // namespace ruffini
