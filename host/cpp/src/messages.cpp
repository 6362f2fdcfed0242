#include "ruffini/client/messages.h"

#include <algorithm>
#include <utility>

#include "reader.h"

namespace ruffini::client {
namespace {

constexpr size_t kMaxContacts = 64, kMaxSensors = 16, kMaxTexts = 64, kMaxTemperatures = 64;  // no device sends so many
constexpr double kMicro = 1e-6, kNano = 1e-9, kMilli = 1e-3;

// A validity or a flag that this library does not know makes a number invalid.
Validity validity_of(uint64_t sent, uint32_t flags = 0) {
  const auto validity = sent <= 3 ? static_cast<Validity>(sent) : Validity::kInvalid;
  return validity == Validity::kValid && (flags & ~kKnownFlags) != 0 ? Validity::kInvalid : validity;
}

Measured measured(double as_sent, Validity validity) {
  return {validity == Validity::kValid ? as_sent : kNaN, as_sent, validity};
}

bool read(Reader r, Stamp& out) {
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) out.capture_us = r.u64();
    if (n == 2) out.frame = r.u64();
    if (n == 3) out.flags = r.u32();
    if (n == 4) out.calibration_id = r.u32();
  }
  return r.ok();
}

// Upper triangle by rows in (uN, uN mm)^2 to the whole in (N, N m)^2.
std::array<std::array<double, 6>, 6> covariance_of(const std::vector<uint64_t>& upper) {
  std::array<std::array<double, 6>, 6> out{};
  size_t i = 0;
  for (size_t row = 0; row < 6; ++row) {
    for (size_t column = row; column < 6; ++column) {
      const double unit = (row < 3 ? kMicro : kNano) * (column < 3 ? kMicro : kNano);
      out[row][column] = out[column][row] = static_cast<double>(unzigzag(upper[i++])) * unit;
    }
  }
  return out;
}

bool read(Reader r, Wrench& out) {
  constexpr double kUnNm = 1e-12;  // uN um
  std::array<double, 6> sent{};
  std::vector<uint64_t> validity, covariance;
  uint64_t covariance_validity = 0;
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1 && !read(r.message(), out.stamp)) return false;
    if (n >= 2 && n <= 7) sent[n - 2] = static_cast<double>(r.s64()) * (n < 5 ? kMicro : kUnNm);
    if (n == 8) r.repeated(validity, 6);
    if (n == 9) r.repeated(covariance, 21);
    if (n == 10) covariance_validity = r.u64();
  }
  if (!r.ok() || (!validity.empty() && validity.size() != 6)) return false;
  validity.resize(6);  // none sent: not measured
  for (size_t i = 0; i < 6; ++i) {
    (i < 3 ? out.force_n[i] : out.torque_nm[i - 3]) = measured(sent[i], validity_of(validity[i], out.stamp.flags));
  }
  if (covariance.size() == 21 && validity_of(covariance_validity, out.stamp.flags) == Validity::kValid) {
    out.covariance = covariance_of(covariance);
  }
  return true;
}

bool read(Reader r, Field& out) {
  std::vector<uint64_t> validity;
  uint64_t sigma_validity = 0;
  bool is_good = true;
  while (is_good && r.next()) {
    const uint32_t n = r.number();
    if (n == 1) is_good = read(r.message(), out.stamp);
    if (n == 2) out.force_step_n = r.u32() * kMicro;
    if (n == 3) is_good = read_grid(r.message(), out.force);
    if (n == 4) out.displacement_step_m = r.u32() * kNano;
    if (n == 5) is_good = read_grid(r.message(), out.displacement);
    if (n == 6) r.repeated(validity, 3);
    if (n == 7) is_good = read_grid(r.message(), out.slip);
    if (n == 8) is_good = read_grid(r.message(), out.sigma);
    if (n == 9) sigma_validity = r.u64();
  }
  if (!is_good || !r.ok() || (!validity.empty() && validity.size() != 3)) return false;
  for (size_t i = 0; i < validity.size(); ++i) out.validity[i] = validity_of(validity[i], out.stamp.flags);
  out.sigma_validity = validity_of(sigma_validity, out.stamp.flags);
  const auto fits = [&](const Grid& grid, uint32_t n_components) {
    return grid.values.empty() ||
           (grid.n_x == out.force.n_x && grid.n_y == out.force.n_y && grid.n_components == n_components);
  };
  return fits(out.force, 3) && fits(out.displacement, 3) && fits(out.sigma, 3) && fits(out.slip, 1);
}

bool read(Reader r, Depth& out) {
  uint64_t validity = 0;
  bool is_good = true;
  while (is_good && r.next()) {
    const uint32_t n = r.number();
    if (n == 1) is_good = read(r.message(), out.stamp);
    if (n == 2) out.step_m = r.u32() * kNano;
    if (n == 3) out.step_px = r.u32();
    if (n == 4) is_good = read_grid(r.message(), out.depth);
    if (n == 5) validity = r.u64();
    if (n == 6) out.sigma_m = r.u32() * kMicro;
  }
  out.validity = validity_of(validity, out.stamp.flags);
  return is_good && r.ok() && (out.depth.values.empty() || out.depth.n_components == 1);
}

bool read(Reader r, Residual& out) {
  uint64_t validity = 0;
  bool is_good = true;
  while (is_good && r.next()) {
    const uint32_t n = r.number();
    if (n == 1) is_good = read(r.message(), out.stamp);
    if (n == 2) out.step = r.u32() * kMicro;
    if (n == 3) is_good = read_grid(r.message(), out.residual);
    if (n == 4) validity = r.u64();
  }
  if (!out.residual.values.empty()) out.validity = validity_of(validity, out.stamp.flags);
  return is_good && r.ok() && (out.residual.values.empty() || out.residual.n_components == 3);
}

// `flags` of the stamp that all contacts have.
bool read(Reader r, Contact& out, uint32_t flags) {
  std::array<double, 3> force{};
  double peak_depth = 0;
  uint64_t validity = 0;
  std::vector<uint64_t> by_axis;
  double ratio = 0, friction = 0, friction_sigma = 0, share = 0, margin = 0;
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) out.id = r.u32();
    if (n == 2) out.area_m2 = r.u32() * kNano;
    if (n == 3 || n == 4) out.center_m[n - 3] = r.s32() * kMicro;
    if (n == 5 || n == 6 || n == 7) force[n - 5] = static_cast<double>(r.s64()) * kMicro;
    if (n == 8) peak_depth = r.s32() * kNano;
    if (n == 9) validity = r.u64();
    if (n == 10) out.slip_state = static_cast<SlipState>(std::min<uint64_t>(r.u64(), 255));
    if (n == 11) ratio = r.u32() * kMilli;
    if (n == 12) friction = r.u32() * kMilli;
    if (n == 13) friction_sigma = r.u32() * kMilli;
    if (n == 14) share = r.u32() * kMilli;
    if (n == 15) margin = static_cast<double>(r.s64()) * kMicro;
    if (n == 16) out.reaches_border = r.u64() != 0;
    if (n == 17) r.repeated(by_axis, 3);
  }
  if (!r.ok() || (!by_axis.empty() && by_axis.size() != 3)) return false;
  for (size_t i = 0; i < 3; ++i) {
    out.force_n[i] = measured(force[i], validity_of(by_axis.empty() ? validity : by_axis[i], flags));
  }
  out.peak_depth_m = measured(peak_depth, validity_of(validity, flags));
  if ((flags & ~kKnownFlags) != 0 || out.slip_state > SlipState::kSlides) out.slip_state = SlipState::kNotMeasured;
  if (out.slip_state == SlipState::kNotMeasured) return true;
  out.shear_ratio = ratio;
  out.slip_share = share;
  if (friction > 0) {
    out.friction = friction;
    out.friction_sigma = friction_sigma;
    out.slip_margin_n = margin;
  }
  return true;
}

bool read(Reader r, Contacts& out) {
  std::vector<Reader> contacts;  // the stamp may come after them
  while (r.next()) {
    if (r.number() == 1 && !read(r.message(), out.stamp)) return false;
    if (r.number() == 2) contacts.push_back(r.message());
    if (r.number() == 3) out.n_found = r.u32();
    if (contacts.size() > kMaxContacts) return false;
  }
  out.contacts.resize(contacts.size());
  for (size_t i = 0; i < contacts.size(); ++i) {
    if (!read(contacts[i], out.contacts[i], out.stamp.flags)) return false;
  }
  return r.ok();
}

bool read(Reader r, SensorInfo& out) {
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) out.sensor = r.u32();
    if (n == 2) out.board = r.text();
    if (n == 3) out.product = r.text();
    if (n == 6) out.n_x = r.u32();
    if (n == 7) out.n_y = r.u32();
    if (n == 8 || n == 9) out.grid_origin_m[n - 8] = static_cast<double>(static_cast<int32_t>(r.u64())) * kNano;
    if (n == 10 || n == 11) out.grid_step_m[n - 10] = r.u32() * kNano;
    if (n == 14) out.not_measured.push_back(r.text());
    if (n == 15) {
      Reader calibration = r.message();
      while (calibration.next()) {
        if (calibration.number() == 1) out.is_calibrated = calibration.u64() != 0;
      }
      if (!calibration.ok()) return false;
    }
    if (out.not_measured.size() > kMaxTexts) return false;
  }
  return r.ok();
}

bool read(Reader r, Hello& out) {
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) out.protocol_version = r.u32();
    if (n == 3) out.firmware_version = r.text();
    if (n == 4) out.device_serial = r.text();
    if (n == 5 && (out.sensors.size() == kMaxSensors || !read(r.message(), out.sensors.emplace_back()))) return false;
    if (n == 6) out.session_id = r.u32();
    if (n == 40) out.needs_key = r.u64() != 0;
  }
  return r.ok();
}

bool read_drops(Reader r, Status& out) {
  while (r.next()) {
    if (r.number() == 1) out.replaced_frames = r.u64();
    if (r.number() == 2) out.dropped_packets = r.u64();
    if (r.number() == 3) out.invalid_frames = r.u64();
  }
  return r.ok();
}

bool read_temperature(Reader r, Status& out) {
  auto& [place, celsius] = out.temperatures_c.emplace_back();
  while (r.next()) {
    if (r.number() == 1) place = r.text();
    if (r.number() == 2) celsius = r.s32() * kMilli;
  }
  return r.ok() && out.temperatures_c.size() <= kMaxTemperatures;
}

bool read(Reader r, Status& out) {
  bool is_good = true;
  while (is_good && r.next()) {
    const uint32_t n = r.number();
    if (n == 1) out.uptime_us = r.u64();
    if (n == 2) out.frame_rate_hz = r.u32() * kMilli;
    if (n == 3) out.frames_captured = r.u64();
    if (n == 4) out.frames_processed = r.u64();
    if (n == 5) is_good = read_drops(r.message(), out);
    if (n == 8) is_good = read_temperature(r.message(), out);
    if (n == 9) out.health = r.u32();
  }
  return is_good && r.ok();
}

bool read(Reader r, Event& out) {
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) out.time_us = r.u64();
    if (n == 2) out.severity = r.u32();
    if (n == 3) out.what = r.text();
    if (n == 4) out.text = r.text();
  }
  return r.ok();
}

bool read(Reader r, Reply& out) {
  while (r.next()) {
    if (r.number() == 1) out.request_id = r.u32();
    if (r.number() == 2) out.code = r.u32();
    if (r.number() == 3) out.text = r.text();
  }
  return r.ok();
}

bool read(Reader r, Time& out) {
  while (r.next()) {
    if (r.number() == 1) out.token = r.u64();
    if (r.number() == 2) out.received_us = r.u64();
    if (r.number() == 3) out.sent_us = r.u64();
  }
  return r.ok();
}

std::array<double, 3> of_node(const Grid& grid, size_t node, double step, const std::array<Validity, 3>& validity) {
  std::array<double, 3> out{kNaN, kNaN, kNaN};
  for (size_t i = 0; i < 3 && !grid.values.empty(); ++i) {
    if (validity[i] == Validity::kValid) out[i] = step * grid.values[3 * node + i];
  }
  return out;
}

}  // namespace

std::array<double, 3> Field::force_n(size_t node) const { return of_node(force, node, force_step_n, validity); }

std::array<double, 3> Field::displacement_m(size_t node) const {
  return of_node(displacement, node, displacement_step_m, validity);
}

std::array<double, 3> Field::sigma_n(size_t node) const {
  return of_node(sigma, node, force_step_n, {sigma_validity, sigma_validity, sigma_validity});
}

double Depth::depth_m(size_t cell) const {
  return validity == Validity::kValid && !depth.values.empty() ? step_m * depth.values[cell] : kNaN;
}

std::array<double, 3> Residual::sigmas(size_t node) const {
  return of_node(residual, node, step, {validity, validity, validity});
}

std::array<double, 2> SensorInfo::position_m(size_t node) const {
  const size_t width = std::max(n_x, 1U);
  return {grid_origin_m[0] + static_cast<double>(node % width) * grid_step_m[0],
          grid_origin_m[1] + static_cast<double>(node / width) * grid_step_m[1]};
}

bool read_message(Type type, const std::vector<uint8_t>& payload, Message& out) {
  const Reader r(payload.data(), payload.size());
  switch (type) {
    case Type::kHello:
      return read(r, out.emplace<Hello>());
    case Type::kStatus:
      return read(r, out.emplace<Status>());
    case Type::kWrench:
      return read(r, out.emplace<Wrench>());
    case Type::kField:
      return read(r, out.emplace<Field>());
    case Type::kDepth:
      return read(r, out.emplace<Depth>());
    case Type::kResidual:
      return read(r, out.emplace<Residual>());
    case Type::kContacts:
      return read(r, out.emplace<Contacts>());
    case Type::kEvent:
      return read(r, out.emplace<Event>());
    case Type::kReply:
      return read(r, out.emplace<Reply>());
    case Type::kTime:
      return read(r, out.emplace<Time>());
    default:
      return true;
  }
}

}  // namespace ruffini::client
