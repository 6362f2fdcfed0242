#include "ruffini/client/messages.h"

#include <algorithm>
#include <initializer_list>
#include <limits>
#include <utility>

#include "reader.h"

namespace ruffini::client {
namespace {

constexpr size_t kMaxContacts = 64, kMaxSensors = 16, kMaxTexts = 64, kMaxTemperatures = 64,
                 kMaxQuantities = 64;  // limits above what any device sends
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

// Converts the upper triangle by rows in (uN, uN mm)^2 to the full matrix in (N, N m)^2.
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
    (i < 3 ? out.force_n[i] : out.torque_n_m[i - 3]) = measured(sent[i], validity_of(validity[i], out.stamp.flags));
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
    if (n == 3) is_good = read_grid(r.message(), out.force_steps);
    if (n == 4) out.displacement_step_m = r.u32() * kNano;
    if (n == 5) is_good = read_grid(r.message(), out.displacement_steps);
    if (n == 6) r.repeated(validity, 3);
    if (n == 7) is_good = read_grid(r.message(), out.slip);
    if (n == 8) is_good = read_grid(r.message(), out.sigma_steps);
    if (n == 9) sigma_validity = r.u64();
  }
  if (!is_good || !r.ok() || (!validity.empty() && validity.size() != 3)) return false;
  for (size_t i = 0; i < validity.size(); ++i) out.validity[i] = validity_of(validity[i], out.stamp.flags);
  out.sigma_validity = validity_of(sigma_validity, out.stamp.flags);
  const auto fits = [&](const Grid& grid, uint32_t n_components) {
    return grid.values.empty() ||
           (grid.n_x == out.force_steps.n_x && grid.n_y == out.force_steps.n_y && grid.n_components == n_components);
  };
  return fits(out.force_steps, 3) && fits(out.displacement_steps, 3) && fits(out.sigma_steps, 3) && fits(out.slip, 1);
}

bool read(Reader r, Depth& out) {
  uint64_t validity = 0;
  bool is_good = true;
  while (is_good && r.next()) {
    const uint32_t n = r.number();
    if (n == 1) is_good = read(r.message(), out.stamp);
    if (n == 2) out.step_m = r.u32() * kNano;
    if (n == 3) out.step_px = r.u32();
    if (n == 4) is_good = read_grid(r.message(), out.depth_steps);
    if (n == 5) validity = r.u64();
    if (n == 6) out.sigma_m = r.u32() * kMicro;
  }
  out.validity = validity_of(validity, out.stamp.flags);
  return is_good && r.ok() && (out.depth_steps.values.empty() || out.depth_steps.n_components == 1);
}

bool read(Reader r, Residual& out) {
  uint64_t validity = 0;
  bool is_good = true;
  while (is_good && r.next()) {
    const uint32_t n = r.number();
    if (n == 1) is_good = read(r.message(), out.stamp);
    if (n == 2) out.step = r.u32() * kMicro;
    if (n == 3) is_good = read_grid(r.message(), out.residual_steps);
    if (n == 4) validity = r.u64();
  }
  if (!out.residual_steps.values.empty()) out.validity = validity_of(validity, out.stamp.flags);
  return is_good && r.ok() && (out.residual_steps.values.empty() || out.residual_steps.n_components == 3);
}

using Raw = std::vector<uint64_t>;  // raw values of a repeated field

constexpr size_t kToolSigmas = 7;

struct RawSlip {
  double ratio = 0, friction = 0, friction_sigma = 0, share = 0, margin = 0;
  uint64_t state = 0;
};

bool read(Reader r, RawSlip& out) {
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) out.state = r.u32();
    if (n == 2) out.ratio = r.u32() * kMilli;
    if (n == 3) out.friction = r.u32() * kMilli;
    if (n == 4) out.friction_sigma = r.u32() * kMilli;
    if (n == 5) out.share = r.u32() * kMilli;
    if (n == 6) out.margin = static_cast<double>(r.s64()) * kMicro;
  }
  return r.ok();
}

double as_s64(uint64_t sent) { return static_cast<double>(unzigzag(sent)); }
double as_s32(uint64_t sent) {
  return static_cast<double>(static_cast<int32_t>(unzigzag(static_cast<uint32_t>(sent))));
}
double stated(double value) { return value > 0 ? value : kNaN; }

struct RawSkin {
  Raw place_um, force_un;
  uint64_t force_sigma_un = 0;
  uint32_t center_sigma_um = 0;
};

bool read(Reader r, RawSkin& out) {
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) r.repeated(out.place_um, 3);
    if (n == 2) r.repeated(out.force_un, 3);
    if (n == 3) out.force_sigma_un = r.u64();
    if (n == 4) out.center_sigma_um = r.u32();
  }
  return r.ok();
}

bool convert(const RawSkin& raw, bool is_valid, SkinTouch& out) {
  if (raw.place_um.size() != 3 || raw.force_un.size() != 3) return false;
  out.place_m.fill(kNaN);
  out.normal_force_n.fill(kNaN);
  if (!is_valid) return true;
  for (size_t i = 0; i < 3; ++i) {
    out.place_m[i] = as_s32(raw.place_um[i]) * kMicro;
    out.normal_force_n[i] = as_s64(raw.force_un[i]) * kMicro;
  }
  out.force_sigma_n = stated(static_cast<double>(raw.force_sigma_un) * kMicro);
  out.center_sigma_m = stated(raw.center_sigma_um * kMicro);
  return true;
}

struct RawTool {
  Raw tool_um, turn_urad, force_un, sigma;
  double flat_area_m2 = 0, flat_area_sigma_m2 = 0;
};

bool read(Reader r, RawTool& out) {
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) r.repeated(out.tool_um, 3);
    if (n == 2) r.repeated(out.turn_urad, 2);
    if (n == 3) r.repeated(out.force_un, 3);
    if (n == 4) r.repeated(out.sigma, kToolSigmas);
    if (n == 5) out.flat_area_m2 = r.u32() * kNano;
    if (n == 6) out.flat_area_sigma_m2 = r.u32() * kNano;
  }
  return r.ok();
}

bool convert(const RawTool& raw, bool is_valid, ToolTouch& out) {
  if (raw.tool_um.size() != 3 || raw.turn_urad.size() != 2 || raw.force_un.size() != 3) return false;
  if (raw.sigma.size() != kToolSigmas) return false;
  out.place_m.fill(kNaN);
  out.normal_force_n.fill(kNaN);
  out.place_sigma_m.fill(kNaN);
  if (!is_valid) return true;
  std::array<double, kToolSigmas> sigma{};
  std::transform(raw.sigma.begin(), raw.sigma.end(), sigma.begin(),
                 [](uint64_t sent) { return static_cast<uint32_t>(sent) * kMicro; });
  out.place_m = {as_s32(raw.tool_um[0]) * kMicro, as_s32(raw.tool_um[1]) * kMicro};
  out.way_m = as_s32(raw.tool_um[2]) * kMicro;
  out.roll_rad = as_s32(raw.turn_urad[0]) * kMicro;
  out.pitch_rad = as_s32(raw.turn_urad[1]) * kMicro;
  for (size_t i = 0; i < 3; ++i) out.normal_force_n[i] = as_s64(raw.force_un[i]) * kMicro;
  out.force_sigma_n = sigma[0];
  out.place_sigma_m = {sigma[1], sigma[2]};
  out.way_sigma_m = sigma[3];
  out.roll_sigma_rad = sigma[4];
  out.pitch_sigma_rad = sigma[5];
  out.face_area_sigma_m2 = sigma[6] * kMilli;
  if (raw.flat_area_m2 <= 0) return true;
  out.flat_area_m2 = raw.flat_area_m2;
  out.flat_area_sigma_m2 = stated(raw.flat_area_sigma_m2);
  return true;
}

struct RawModel {
  uint64_t depth_validity = 0, hardness_validity = 0, kind = 0;
  double kind_confidence = 0;
  ContactModel as_sent;
};

bool read(Reader r, RawModel& out) {
  constexpr double kTenth = 0.1, kPerMicro = 1e6;
  ContactModel& m = out.as_sent;
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) out.depth_validity = r.u32();
    if (n == 2) out.kind = r.u32();
    if (n == 3) out.kind_confidence = r.u32() * kMilli;
    if (n == 4) m.gel_depth_m = r.u32() * kMicro;
    if (n == 5) m.press_depth_m = r.u32() * kMicro;
    if (n == 6) m.gel_depth_sigma_m = r.u32() * kMicro;
    if (n == 7) m.effective_area_m2 = r.u32() * kNano;
    if (n == 8) m.stiffness_pa_per_m = r.s32() * kPerMicro;
    if (n == 9) m.shore_a = r.u32() * kTenth;
    if (n == 10) m.shore_a_sigma = r.u32() * kTenth;
    if (n == 11) out.hardness_validity = r.u32();
    if (n == 12) m.mean_flow_m = r.u32() * kMicro;
    if (n == 13) m.moment_by_flow_n_m = static_cast<double>(r.u64()) * kNano;
  }
  return r.ok();
}

// Zero is absent from the wire.
void set_unless_valid(Validity validity, std::initializer_list<double*> numbers) {
  for (double* number : numbers) *number = validity != Validity::kValid ? kNaN : *number != *number ? 0.0 : *number;
}

ContactModel model_of(const RawModel& raw, uint32_t flags) {
  ContactModel out = raw.as_sent;
  out.depth_validity = validity_of(raw.depth_validity, flags);
  out.hardness_validity = validity_of(raw.hardness_validity, flags);
  set_unless_valid(out.depth_validity,
                   {&out.gel_depth_m, &out.gel_depth_sigma_m, &out.press_depth_m, &out.effective_area_m2});
  set_unless_valid(out.hardness_validity, {&out.stiffness_pa_per_m, &out.shore_a, &out.shore_a_sigma});
  if (raw.kind == 1 || raw.kind == 2) {
    out.kind = static_cast<ContactKind>(raw.kind);
    out.kind_confidence = raw.kind_confidence;
  }
  return out;
}

bool read(Reader r, FlowParts& out) {
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) out.curl_free_m = r.u32() * kNano;
    if (n == 2) out.divergence_free_m = r.u32() * kNano;
    if (n == 3) out.twist_rad = r.s32() * kMicro;
  }
  return r.ok();
}

// Reads the stage's message; repeated parts of one message are merged.
template <typename Part>
bool read_part(Reader r, std::optional<Part>& out) {
  return read(r, out ? *out : out.emplace());
}

// `flags`: from the stamp, common to all contacts.
bool read(Reader r, Contact& out, uint32_t flags) {
  std::array<double, 3> force{};
  double peak_depth = 0;
  uint64_t validity = 0;
  Raw by_axis;
  RawSlip slip;
  std::optional<RawSkin> skin;
  std::optional<RawTool> tool;
  std::optional<RawModel> model;
  bool is_good = true;
  while (is_good && r.next()) {
    const uint32_t n = r.number();
    if (n == 1) out.id = r.u32();
    if (n == 2) out.area_m2 = r.u32() * kNano;
    if (n == 3 || n == 4) out.center_m[n - 3] = r.s32() * kMicro;
    if (n == 5 || n == 6 || n == 7) force[n - 5] = static_cast<double>(r.s64()) * kMicro;
    if (n == 8) peak_depth = r.s32() * kNano;
    if (n == 9) validity = r.u64();
    if (n == 16) out.reaches_border = r.u64() != 0;
    if (n == 17) r.repeated(by_axis, 3);
    if (n == 43) is_good = read_part(r.message(), out.flow_parts);
    if (n == 50) is_good = read(r.message(), slip);
    if (n == 51) is_good = read_part(r.message(), skin);
    if (n == 52) is_good = read_part(r.message(), tool);
    if (n == 53) is_good = read_part(r.message(), model);
  }
  if (!is_good || !r.ok() || (!by_axis.empty() && by_axis.size() != 3)) return false;
  for (size_t i = 0; i < 3; ++i) {
    out.force_n[i] = measured(force[i], validity_of(by_axis.empty() ? validity : by_axis[i], flags));
  }
  out.peak_depth_m = measured(peak_depth, validity_of(validity, flags));
  const bool is_valid = out.force_n[2].validity == Validity::kValid;
  if (skin && !convert(*skin, is_valid, out.skin.emplace())) return false;
  if (tool && !convert(*tool, is_valid, out.tool.emplace())) return false;
  if (model) out.model = model_of(*model, flags);
  if ((flags & ~kKnownFlags) != 0 || slip.state == 0 || slip.state > 3) return true;
  out.slip_state = static_cast<SlipState>(slip.state);
  out.shear_ratio = slip.ratio;
  out.slip_share = slip.share;
  if (slip.friction > 0) {
    out.friction = slip.friction;
    out.friction_sigma = slip.friction_sigma;
    out.slip_margin_n = slip.margin;
  }
  return true;
}

struct RawSoftness {
  uint64_t validity = 0;
  Softness as_sent;

  // Zero is absent from the wire.
  RawSoftness() {
    Softness& s = as_sent;
    s.modulus_pa = s.low_pa = s.high_pa = s.log2_share = s.log2_share_sigma = 0.0;
  }
};

bool read(Reader r, RawSoftness& out) {
  constexpr double kQ16 = 1.0 / 65'536;
  Softness& s = out.as_sent;
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1) out.validity = r.u64();
    if (n == 2) s.squeeze = r.u32();
    if (n == 3) s.n_frames = r.u32();
    if (n == 4) s.modulus_pa = r.u32();
    if (n == 5) s.low_pa = r.u32();
    if (n == 6) s.high_pa = r.u32();
    if (n == 7) s.log2_share = r.s32() * kQ16;
    if (n == 8) s.log2_share_sigma = r.u32() * kQ16;
  }
  return r.ok();
}

Softness softness_of(const RawSoftness& raw, uint32_t flags) {
  constexpr double kInfinite = std::numeric_limits<double>::infinity();
  Softness out = raw.as_sent;
  out.validity = validity_of(raw.validity, flags);
  for (double* limit : {&out.modulus_pa, &out.high_pa}) *limit = *limit == 0 ? kInfinite : *limit;
  set_unless_valid(out.validity, {&out.modulus_pa, &out.low_pa, &out.high_pa, &out.log2_share, &out.log2_share_sigma});
  return out;
}

bool read(Reader r, Contacts& out) {
  std::vector<Reader> contacts;  // the stamp may follow them
  std::optional<RawSoftness> softness;
  while (r.next()) {
    if (r.number() == 1 && !read(r.message(), out.stamp)) return false;
    if (r.number() == 2) contacts.push_back(r.message());
    if (r.number() == 3) out.n_found = r.u32();
    if (r.number() == 4 && !read_part(r.message(), softness)) return false;
    if (contacts.size() > kMaxContacts) return false;
  }
  out.contacts.resize(contacts.size());
  for (size_t i = 0; i < contacts.size(); ++i) {
    if (!read(contacts[i], out.contacts[i], out.stamp.flags)) return false;
  }
  if (softness) out.softness = softness_of(*softness, out.stamp.flags);
  return r.ok();
}

bool read(Reader r, Markers& out) {
  uint32_t n_x = 0, n_y = 0;
  const uint8_t* lost = nullptr;
  size_t n_lost = 0;
  bool is_good = true;
  while (is_good && r.next()) {
    const uint32_t n = r.number();
    if (n == 1) is_good = read(r.message(), out.stamp);
    if (n == 2) n_x = r.u32();
    if (n == 3) n_y = r.u32();
    if (n == 4) out.step_px = r.u32() * kMicro;
    if (n == 5) is_good = read_grid(r.message(), out.displacement);
    if (n == 6) r.bytes(lost, n_lost);
    if (n == 7) is_good = read_grid(r.message(), out.rest);
    if (n == 8) is_good = read_grid(r.message(), out.quality);
    if (n == 9) is_good = read_grid(r.message(), out.area);
  }
  const auto fits = [&](const Grid& grid, uint32_t n_components) {
    return grid.values.empty() || (grid.n_x == n_x && grid.n_y == n_y && grid.n_components == n_components);
  };
  if (!is_good || !r.ok() || (out.displacement.values.empty() && n_x > 0 && n_y > 0)) return false;
  if (!fits(out.displacement, 2) || !fits(out.rest, 2) || !fits(out.quality, 1) || !fits(out.area, 1)) return false;
  out.is_lost.resize(out.displacement.n_nodes());
  for (size_t i = 0; i < out.is_lost.size() && i / 8 < n_lost; ++i)
    out.is_lost[i] = ((lost[i / 8] >> (i % 8)) & 1) != 0;
  return true;
}

bool read(Reader r, Learned& out) {
  uint64_t validity = 0;
  while (r.next()) {
    const uint32_t n = r.number();
    if (n == 1 && !read(r.message(), out.stamp)) return false;
    if (n == 2) validity = r.u64();
    if (n == 3) {
      if (out.quantities.size() == kMaxQuantities) return false;
      auto& [name, value] = out.quantities.emplace_back();
      Reader quantity = r.message();
      while (quantity.next()) {
        if (quantity.number() == 1) name = quantity.text();
        if (quantity.number() == 2) value = quantity.s64();
      }
      if (!quantity.ok()) return false;
    }
    if (n == 4) out.took_s = r.u32() * kMicro;
    if (n == 5) out.latency_s = r.u32() * kMicro;
    if (n == 6) out.period_s = r.u32() * kMicro;
  }
  out.is_valid = validity_of(validity, out.stamp.flags) == Validity::kValid;
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
        const uint32_t part = calibration.number();
        if (part == 1) out.is_calibrated = calibration.u64() != 0;
        if (part == 5) out.has_development_key = calibration.u64() != 0;
        if (part == 7) out.calibration_summary = calibration.text();
        if (part == 8) out.is_on_trial = calibration.u64() != 0;
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

std::array<double, 3> Field::force_n_at(size_t node) const {
  return of_node(force_steps, node, force_step_n, validity);
}

std::array<double, 3> Field::displacement_m_at(size_t node) const {
  return of_node(displacement_steps, node, displacement_step_m, validity);
}

std::array<double, 3> Field::sigma_n_at(size_t node) const {
  std::array<Validity, 3> both = validity;
  if (sigma_validity != Validity::kValid) both.fill(sigma_validity);
  return of_node(sigma_steps, node, force_step_n, both);
}

double Depth::depth_m_at(size_t cell) const {
  return validity == Validity::kValid && !depth_steps.values.empty() ? step_m * depth_steps.values[cell] : kNaN;
}

std::array<double, 3> Residual::sigmas_at(size_t node) const {
  return of_node(residual_steps, node, step, {validity, validity, validity});
}

std::array<double, 2> SensorInfo::position_m_at(size_t node) const {
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
    case Type::kMarkers:
      return read(r, out.emplace<Markers>());
    case Type::kLearned:
      return read(r, out.emplace<Learned>());
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
