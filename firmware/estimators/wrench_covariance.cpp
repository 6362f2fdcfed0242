#include "estimators/wrench_covariance.h"

#include <algorithm>
#include <cstdlib>

#include "base/filled.h"
#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int kFactorFraction = 20;
constexpr int kFilledFraction = 8;
constexpr int64_t kUmPerMm = 1'000;
constexpr int64_t kMaxUnlisted = 16;  // contacts counted one by one, at most
constexpr int64_t kMaxReading = int64_t{1} << 40;
constexpr int64_t kMaxPlace_um = int64_t{1} << 17;

// Limits of the parameters: sigma of force and moment, lever, factor.
constexpr std::array<int32_t, 4> kLowest = {100, 100, 0, 0};
constexpr std::array<int32_t, 4> kHighest = {1 << 20, 1 << 24, 1 << 20, 1 << 20};
constexpr const char* kCrosstalk = "support.error_crosstalk";

// Rounds half up.
int64_t rounded(int64_t numerator, int64_t denominator) {
  return floor_div(2 * numerator + denominator, 2 * denominator);
}

int64_t clamp_symmetric(int64_t x, int64_t limit = WrenchErrorModel::kMaxSigma) { return std::clamp(x, -limit, limit); }

// factor / 2^fraction of a reading, rounded half up and clamped.
int64_t part_of(int64_t factor, int64_t reading, int fraction) {
  return clamp_symmetric(round_shift(factor * clamp_symmetric(reading, kMaxReading), fraction));
}

}  // namespace

void add_outer(WrenchCovariance& sum, const std::array<int64_t, 6>& v, int64_t times) {
  size_t k = 0;
  for (size_t i = 0; i < v.size(); ++i) {
    for (size_t j = i; j < v.size(); ++j, ++k) sum.upper[k] += times * (v[i] * v[j]);
  }
}

FilledForce sum_filled(const NodeGrid& grid, std::span<const NodeForce> force, std::span<const uint8_t> filled,
                       int64_t force_lsb_un) {
  FilledForce sum;
  size_t i = 0;
  for (int row = 0; row < grid.size().n_y; ++row) {
    const int64_t y = grid.twice_steps_y(row);
    for (int column = 0; column < grid.size().n_x; ++column, ++i) {
      if (filled[i] == kNothingFilled) continue;
      const int64_t x = grid.twice_steps_x(column);
      const int64_t fx = std::abs(int64_t{force[i].x});
      const int64_t fy = std::abs(int64_t{force[i].y});
      const int64_t fz = filled[i] == kAllFilled ? std::abs(int64_t{force[i].z}) : 0;
      sum.x_un += fx;
      sum.y_un += fy;
      sum.z_un += fz;
      sum.y_of_x_un_um += y * fx;
      sum.x_of_y_un_um += x * fy;
      sum.y_of_z_un_um += y * fz;
      sum.x_of_z_un_um += x * fz;
    }
  }
  return {.x_un = sum.x_un * force_lsb_un,
          .y_un = sum.y_un * force_lsb_un,
          .z_un = sum.z_un * force_lsb_un,
          .y_of_x_un_um = grid.to_um_y(sum.y_of_x_un_um * force_lsb_un),
          .x_of_y_un_um = grid.to_um_x(sum.x_of_y_un_um * force_lsb_un),
          .y_of_z_un_um = grid.to_um_y(sum.y_of_z_un_um * force_lsb_un),
          .x_of_z_un_um = grid.to_um_x(sum.x_of_z_un_um * force_lsb_un)};
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
  if (calibration.tensor(kCrosstalk) != nullptr) {
    auto crosstalk = calibration.tensor(kCrosstalk, Tensor::Type::kI32, {1});
    if (!crosstalk) return crosstalk.error();
    out.crosstalk_q20_ = crosstalk.value()->as<int32_t>()[0];
    if (out.crosstalk_q20_ < kLowest[3] || out.crosstalk_q20_ > kHighest[3]) {
      return Error{ErrorKind::kBadInput,
                   "calibration file: support.error_crosstalk is out of range: make the operator again"};
    }
  }
  out.half_x_um_ = clamp_symmetric(pad.size_x_um / 2, kMaxPlace_um);
  out.half_y_um_ = clamp_symmetric(pad.size_y_um / 2, kMaxPlace_um);
  return out;
}

// Adds the errors of a force at (x, y), whose wrench about the origin is (F, X x F).
void WrenchErrorModel::add_contact(WrenchCovariance& sum, const Contact& contact) const {
  const int64_t x = clamp_symmetric(contact.center_x_um, kMaxPlace_um);
  const int64_t y = clamp_symmetric(contact.center_y_um, kMaxPlace_um);
  const int64_t pressing = clamp_symmetric(contact.force_z_un, kMaxReading);
  for (const int64_t shear : {contact_.force_un[0], part_of(crosstalk_q20_, pressing, kFactorFraction)}) {
    add_outer(sum, {shear, 0, 0, 0, 0, clamp_symmetric(rounded(-y * shear, kUmPerMm))});
    add_outer(sum, {0, shear, 0, 0, 0, clamp_symmetric(rounded(x * shear, kUmPerMm))});
  }
  const int64_t normal = contact_.force_un[1];
  add_outer(sum, {0, 0, normal, clamp_symmetric(rounded(y * normal, kUmPerMm)),
                  clamp_symmetric(rounded(-x * normal, kUmPerMm)), 0});
  for (size_t axis = 3; axis < 6; ++axis) {
    const size_t part = axis == 5 ? 1 : 0;
    Vector constant{};
    Vector proportional{};
    constant[axis] = contact_.moment_un_mm[part];
    proportional[axis] = clamp_symmetric(rounded(contact_.lever_nm[part] * pressing, kUmPerMm * kUmPerMm));
    add_outer(sum, constant);
    add_outer(sum, proportional);
  }
}

// Their lever is half the pad in both directions.
void WrenchErrorModel::add_unlisted(WrenchCovariance& sum, int64_t n_contacts) const {
  const int64_t n = std::min(n_contacts, kMaxUnlisted);
  const auto [shear, normal] = contact_.force_un;
  const auto [bending, torsion] = contact_.moment_un_mm;
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

WrenchCovariance WrenchErrorModel::run(const Wrench& w, const ContactList& contacts, const FilledForce& filled) const {
  WrenchCovariance sum;
  const auto mm = [](int64_t torque_un_um) { return rounded(torque_un_um, kUmPerMm); };
  const auto parts = [&](int64_t shear, int64_t pressure) {
    return Vector{part_of(shear, w.force_x_un, kFactorFraction),
                  part_of(shear, w.force_y_un, kFactorFraction),
                  part_of(pressure, w.force_z_un, kFactorFraction),
                  part_of(pressure, mm(w.torque_x_un_um), kFactorFraction),
                  part_of(pressure, mm(w.torque_y_un_um), kFactorFraction),
                  part_of(shear, mm(w.torque_z_un_um), kFactorFraction)};
  };
  add_outer(sum, parts(factor_q20_[0], 0));
  add_outer(sum, parts(0, factor_q20_[1]));
  add_outer(sum, parts(stiffness_q20_, stiffness_q20_));
  const auto shear = [](int64_t of) { return part_of(kFilledShear_q8, of, kFilledFraction); };
  const auto normal = [](int64_t of) { return part_of(kFilledNormal_q8, of, kFilledFraction); };
  add_outer(sum, {shear(filled.x_un), 0, 0, 0, 0, -shear(mm(filled.y_of_x_un_um))});
  add_outer(sum, {0, shear(filled.y_un), 0, 0, 0, shear(mm(filled.x_of_y_un_um))});
  add_outer(sum, {0, 0, normal(filled.z_un), normal(mm(filled.y_of_z_un_um)), -normal(mm(filled.x_of_z_un_um)), 0});
  for (int i = 0; i < contacts.n_listed; ++i) add_contact(sum, contacts.contacts[static_cast<size_t>(i)]);
  if (contacts.n_found == 0) add_contact(sum, {});
  if (contacts.n_found > contacts.n_listed) add_unlisted(sum, contacts.n_found - contacts.n_listed);
  return sum;
}

}  // namespace ruffini
