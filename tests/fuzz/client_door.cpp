// The C++ consumer behind a C interface: tests/py/client/test_cpp_against_python.py holds it to the host's decoder.
#include <algorithm>
#include <array>
#include <cstdint>
#include <variant>
#include <vector>

#include "link/frame_codec.h"
#include "ruffini/client.h"

namespace {

namespace client = ruffini::client;

// Numbers in the order in which the fields of ruffini.proto stand; of a Measured its value, as sent and the validity.
class Said {
 public:
  std::vector<double> numbers;

  void put(double v) { numbers.push_back(v); }
  void put(const client::Stamp& s) {
    put(static_cast<double>(s.capture_us));
    put(static_cast<double>(s.frame));
    put(s.flags);
    put(s.calibration_id);
  }
  void put(const client::Measured& m) {
    put(m.value);
    put(m.as_sent);
    put(static_cast<double>(m.validity));
  }
  void put(const client::Grid& grid) {
    put(grid.n_x);
    put(grid.n_y);
    for (const int32_t v : grid.values) put(v);
  }

  void operator()(const std::monostate&) {}
  void operator()(const client::Hello& h) {
    put(h.session_id);
    put(h.needs_key ? 1 : 0);
    for (const auto& s : h.sensors) {
      put(s.sensor);
      put(s.n_x);
      put(s.n_y);
      for (const double v : {s.grid_origin_m[0], s.grid_origin_m[1], s.grid_step_m[0], s.grid_step_m[1]}) put(v);
      for (const bool is_so : {s.is_calibrated, s.has_development_key, s.is_on_trial}) put(is_so ? 1 : 0);
      for (const char letter : s.calibration_summary) put(static_cast<double>(letter));
    }
  }
  void operator()(const client::Status& s) {
    put(static_cast<double>(s.uptime_us));
    put(s.frame_rate_hz);
    put(static_cast<double>(s.replaced_frames));
    put(static_cast<double>(s.invalid_frames));
    put(static_cast<double>(s.dropped_packets));
    put(s.health);
    for (const auto& [place, celsius] : s.temperatures_c) put(celsius);
  }
  void operator()(const client::Wrench& w) {
    put(w.stamp);
    for (const auto& m : w.force_n) put(m);
    for (const auto& m : w.torque_n_m) put(m);
    if (!w.covariance) return;
    for (const auto& row : *w.covariance) {
      for (const double v : row) put(v);
    }
  }
  void operator()(const client::Field& f) {
    put(f.stamp);
    put(f.force_step_n);
    put(f.displacement_step_m);
    put(static_cast<double>(f.sigma_validity));
    for (const client::Validity v : f.validity) put(static_cast<double>(v));
    for (const client::Grid* grid : {&f.force_steps, &f.displacement_steps, &f.slip, &f.sigma_steps}) put(*grid);
  }
  void operator()(const client::Depth& d) {
    put(d.stamp);
    put(d.step_m);
    put(d.step_px);
    put(d.sigma_m);
    put(static_cast<double>(d.validity));
    put(d.depth_steps);
  }
  void operator()(const client::Residual& r) {
    put(r.stamp);
    put(r.step);
    put(static_cast<double>(r.validity));
    if (r.residual_steps.n_nodes() > 0) {
      for (const double sigma : r.sigmas_at(0)) put(sigma);
    }
    put(r.residual_steps);
  }
  void operator()(const client::Contacts& c) {
    put(c.stamp);
    put(c.n_found);
    for (const auto& one : c.contacts) {
      put(one.id);
      put(one.area_m2);
      for (const double v : one.center_m) put(v);
      for (const auto& m : one.force_n) put(m);
      put(one.peak_depth_m);
      put(static_cast<double>(one.slip_state));
      for (const double v : {one.shear_ratio, one.slip_share, one.friction, one.friction_sigma, one.slip_margin_n})
        put(v);
      put(one.reaches_border ? 1 : 0);
      if (one.skin) put(*one.skin);
      if (one.tool) put(*one.tool);
      if (one.model) put(*one.model);
      if (one.flow_parts) {
        for (const double v :
             {one.flow_parts->curl_free_m, one.flow_parts->divergence_free_m, one.flow_parts->twist_rad})
          put(v);
      }
    }
    if (c.softness) put(*c.softness);
  }
  void put(const client::Softness& s) {
    for (const double v : {static_cast<double>(s.squeeze), static_cast<double>(s.n_frames), s.modulus_pa, s.low_pa,
                           s.high_pa, s.log2_share, s.log2_share_sigma, static_cast<double>(s.validity)})
      put(v);
  }
  void put(const client::SkinTouch& s) {
    for (const double v : s.place_m) put(v);
    for (const double v : s.normal_force_n) put(v);
    for (const double v : {s.force_sigma_n, s.center_sigma_m}) put(v);
  }
  void put(const client::ToolTouch& t) {
    for (const double v : {t.place_m[0], t.place_m[1], t.way_m, t.roll_rad, t.pitch_rad}) put(v);
    for (const double v : t.normal_force_n) put(v);
    for (const double v : {t.force_sigma_n, t.place_sigma_m[0], t.place_sigma_m[1], t.way_sigma_m, t.roll_sigma_rad,
                           t.pitch_sigma_rad, t.face_area_sigma_m2, t.flat_area_m2, t.flat_area_sigma_m2})
      put(v);
  }
  void put(const client::ContactModel& m) {
    put(static_cast<double>(m.kind));
    put(m.kind_confidence);
    for (const double v : {m.gel_depth_m, m.gel_depth_sigma_m, m.press_depth_m, m.effective_area_m2}) put(v);
    put(static_cast<double>(m.depth_validity));
    for (const double v : {m.stiffness_pa_per_m, m.shore_a, m.shore_a_sigma}) put(v);
    put(static_cast<double>(m.hardness_validity));
    for (const double v : {m.mean_flow_m, m.moment_by_flow_n_m}) put(v);
  }
  void operator()(const client::Markers& m) {
    put(m.stamp);
    put(m.step_px);
    for (const client::Grid* grid : {&m.displacement, &m.rest, &m.quality, &m.area}) put(*grid);
    for (const bool is_lost : m.is_lost) put(is_lost ? 1 : 0);
  }
  void operator()(const client::Learned& m) {
    put(m.stamp);
    put(m.is_valid ? 1 : 0);
    for (const auto& [name, value] : m.quantities) {
      for (const char letter : name) put(static_cast<double>(letter));
      put(static_cast<double>(value));
    }
    for (const double v : {m.took_s, m.latency_s, m.period_s}) put(v);
  }
  void operator()(const client::Event& e) {
    put(static_cast<double>(e.time_us));
    put(e.severity);
  }
  void operator()(const client::Reply& r) {
    put(r.request_id);
    put(r.code);
  }
  void operator()(const client::Time& t) {
    put(static_cast<double>(t.token));
    put(static_cast<double>(t.received_us));
    put(static_cast<double>(t.sent_us));
  }
};

}  // namespace

extern "C" {

// What the consumer says of a payload of one frame, into `out`. Returns how many numbers, -1: it is no message, -2: `capacity`.
int64_t ruffini_client_says(int type, const uint8_t* payload, int64_t n, double* out, int64_t capacity) {
  std::array<uint8_t, ruffini::kMaxFrameBytes> frame;
  const size_t n_bytes =
      ruffini::encode_frame({0, static_cast<uint8_t>(type), 0, 0, 0, 1}, {payload, static_cast<size_t>(n)}, frame);
  client::Decoder decoder;
  Said said;
  for (const auto& packet : decoder.feed(frame.data(), n_bytes)) std::visit(said, packet.message);
  if (decoder.counters().undecodable > 0) return -1;
  if (static_cast<int64_t>(said.numbers.size()) > capacity) return -2;
  std::copy(said.numbers.begin(), said.numbers.end(), out);
  return static_cast<int64_t>(said.numbers.size());
}
}
