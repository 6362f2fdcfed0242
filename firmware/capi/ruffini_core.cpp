#include "capi/ruffini_core.h"

#include <algorithm>
#include <chrono>
#include <string>

#include "board/parse.h"
#include "frame_path.h"
#include "stages/feature_wrench/feature_wrench.h"
#include "stages/skin/skin_shape.h"

#ifndef RUFFINI_VERSION
#define RUFFINI_VERSION "0"
#endif

using ruffini::FramePath;

struct ruffini_pipeline {
  std::unique_ptr<FramePath> path;
};

struct ruffini_wrench {
  ruffini::FeatureWrench map;
  size_t n;
};

namespace {

thread_local std::string last_error;
thread_local std::string last_board;  // as JSON

int fail(const std::string& message) {
  last_error = message;
  return 1;
}

uint64_t now_ns() {
  return static_cast<uint64_t>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
          .count());
}

template <typename Range, typename Out>
int copy_raw(const Range& range, Out* out) {
  std::transform(range.begin(), range.end(), out, [](const auto& value) { return value.raw(); });
  return 0;
}

}  // namespace

const char* ruffini_version(void) { return RUFFINI_VERSION; }
const char* ruffini_error(void) { return last_error.c_str(); }

const char* ruffini_board_json(const char* toml, size_t toml_bytes, const char* where) {
  auto board = ruffini::board_json({toml, toml_bytes}, where);
  if (!board) return fail(board.error().message), nullptr;
  last_board = std::move(board).value();
  return last_board.c_str();
}

ruffini_pipeline* ruffini_open(const char* toml, size_t toml_bytes, const char* where, const uint8_t* calibration,
                               size_t calibration_bytes) {
  const auto board = ruffini::parse_board({toml, toml_bytes}, where);
  if (!board) return fail(board.error().message), nullptr;
  std::shared_ptr<const ruffini::CalibrationFile> file;
  if (calibration != nullptr) {
    auto loaded = ruffini::CalibrationFile::load({calibration, calibration_bytes});
    if (!loaded) return fail(loaded.error().message), nullptr;
    // Offline there is no sensor whose serial number could differ: a file for one sensor is computed with as it is.
    const ruffini::Calibration& offered = loaded.value()->get();
    const ruffini::Status fits = offered.check_target(board.value(), offered.text("sensor_serial"));
    if (!fits) return fail(fits.error().message), nullptr;
    file = loaded.value();
  }
  auto path = FramePath::configure(board.value(), file, now_ns);
  if (!path) return fail(path.error().message), nullptr;
  return new ruffini_pipeline{std::move(path).value()};
}

void ruffini_close(ruffini_pipeline* pipeline) { delete pipeline; }

int ruffini_layout(const ruffini_pipeline* pipeline, ruffini_layout_t* out) {
  const FramePath& path = *pipeline->path;
  const ruffini::BoardSettings& board = path.board();
  const auto x =
      ruffini::observed_nodes(board.grid.n_x, board.pad.size_x_um, board.window.min_x_um, board.window.max_x_um);
  const auto y =
      ruffini::observed_nodes(board.grid.n_y, board.pad.size_y_um, board.window.min_y_um, board.window.max_y_um);
  *out = {.width_px = board.camera.width_px,
          .height_px = board.camera.height_px,
          .depth_n_x = path.state().depth.grid.n_x,
          .depth_n_y = path.state().depth.grid.n_y,
          .depth_step_px = path.state().depth.step_px,
          .node_n_x = x.count,
          .node_n_y = y.count,
          .node_first_x = x.first,
          .node_first_y = y.first,
          .marker_n_x = board.markers.lattice.n_x,
          .marker_n_y = board.markers.lattice.n_y,
          .force_lsb_un = static_cast<int32_t>(board.force_lsb_un),
          .n_targets = static_cast<int32_t>(path.targets().size())};
  return 0;
}

int ruffini_process(ruffini_pipeline* pipeline, const uint8_t* bgr, int32_t width_px, int32_t height_px,
                    uint64_t capture_us, ruffini_result_t* out) {
  FramePath& path = *pipeline->path;
  const ruffini::CameraSettings& camera = path.board().camera;
  if (width_px != camera.width_px || height_px != camera.height_px) {
    return fail("frame is " + std::to_string(width_px) + "x" + std::to_string(height_px) + ", the board's camera " +
                std::to_string(camera.width_px) + "x" + std::to_string(camera.height_px) +
                ": use the right board or resolution");
  }
  const ruffini::FrameState& s = path.process({bgr, width_px, height_px, 3, ptrdiff_t{3} * width_px}, capture_us);
  const ruffini::Wrench& w = s.wrench.sum;
  *out = {.flags = s.flags,
          .force_xy = static_cast<int32_t>(s.force.xy),
          .force_z = static_cast<int32_t>(s.force.z),
          .depth = static_cast<int32_t>(s.depth.validity),
          .wrench_validity = {},
          .n_markers_lost = s.markers.n_lost + s.targets.n_lost,
          .n_markers_at_rest = path.n_markers_at_rest(),
          .saturations = s.saturations.count,
          .wrench = {w.force_x_un, w.force_y_un, w.force_z_un, w.torque_x_un_um, w.torque_y_un_um, w.torque_z_un_um},
          .n_contacts = s.contacts.n_found,
          .stage_ns = {}};
  static_assert(sizeof out->stage_ns == sizeof s.stage_ns);
  std::copy(s.stage_ns.begin(), s.stage_ns.end(), out->stage_ns);
  std::transform(s.wrench.validity.begin(), s.wrench.validity.end(), out->wrench_validity,
                 [](ruffini::Validity v) { return static_cast<int32_t>(v); });
  return 0;
}

int ruffini_zero(ruffini_pipeline* pipeline, int32_t n_frames) {
  if (n_frames < 0 || n_frames > 256) return fail("zero takes 0 to 256 frames, got " + std::to_string(n_frames));
  pipeline->path->zero(n_frames);
  return 0;
}

int ruffini_set_rest(ruffini_pipeline* pipeline, const uint16_t* image) {
  pipeline->path->set_rest({image, pipeline->path->rest_image().size()});
  return 0;
}

int ruffini_set_live(ruffini_pipeline* pipeline, int32_t is_live) {
  pipeline->path->set_live(is_live != 0);
  return 0;
}

int ruffini_set_temperature(ruffini_pipeline* pipeline, int32_t milli_celsius) {
  const bool is_known = milli_celsius != INT32_MIN;
  pipeline->path->set_temperature(is_known ? std::optional<int32_t>(milli_celsius) : std::nullopt);
  return 0;
}

int ruffini_solve(ruffini_pipeline* pipeline, const int16_t* displacement, int32_t n_frames, int32_t* force) {
  FramePath& path = *pipeline->path;
  const auto n_nodes = static_cast<size_t>(path.nodes().size().count());
  std::vector<ruffini::NodeDisplacement> u(n_nodes);
  using Um = ruffini::DisplacementUm;
  for (int32_t frame = 0; frame < n_frames; ++frame, displacement += 3 * n_nodes, force += 3 * n_nodes) {
    for (size_t i = 0; i < n_nodes; ++i) {
      u[i] = {Um::from_raw(displacement[3 * i]), Um::from_raw(displacement[3 * i + 1]),
              Um::from_raw(displacement[3 * i + 2])};
    }
    path.solve(u);
    ruffini_get_force(pipeline, force);
  }
  return 0;
}

int ruffini_get_markers(const ruffini_pipeline* pipeline, int32_t* rest_q16, int32_t* displacement_q16, uint8_t* lost) {
  for (const ruffini::Marker& m : pipeline->path->markers()) {
    *rest_q16++ = m.rest_x.raw();
    *rest_q16++ = m.rest_y.raw();
    *displacement_q16++ = m.displacement_x.raw();
    *displacement_q16++ = m.displacement_y.raw();
    *lost++ = m.is_absent ? uint8_t{2} : static_cast<uint8_t>(m.is_lost);
  }
  return 0;
}

int ruffini_triangulate(const ruffini_pipeline* pipeline, const int32_t* places_q16, int32_t n, int32_t* out) {
  const auto& views = pipeline->path->views();
  if (!views) return fail("the calibration holds no views of this board: make them with `ruffini cal fit --only camera --views`");
  for (int32_t i = 0; i < n; ++i, places_q16 += 4, out += 4) {
    const ruffini::Meeting met =
        meet(views->at(0, places_q16[0], places_q16[1]), views->at(1, places_q16[2], places_q16[3]));
    const int64_t values[4] = {met.x_q8, met.y_q8, met.z_q8, met.gap_q8};
    std::transform(values, values + 4, out, [&](int64_t v) {
      return met.is_found ? static_cast<int32_t>(std::clamp<int64_t>(v, -INT32_MAX, INT32_MAX)) : INT32_MIN;
    });
  }
  return 0;
}

ruffini_wrench* ruffini_wrench_open(const uint8_t* calibration, size_t calibration_bytes, const char* features,
                                    int32_t n) {
  auto file = ruffini::CalibrationFile::load({calibration, calibration_bytes});
  if (!file) return fail(file.error().message), nullptr;
  if (!file.value()->get().has_kind("wrench")) return fail("this calibration has no wrench: fit one"), nullptr;
  auto map = ruffini::FeatureWrench::load(file.value()->get(), features, n);
  if (!map) return fail(map.error().message), nullptr;
  return new ruffini_wrench{std::move(map.value()), static_cast<size_t>(n)};
}

void ruffini_wrench_close(ruffini_wrench* wrench) { delete wrench; }

int ruffini_wrench_run(ruffini_wrench* wrench, const int32_t* features, const uint64_t* capture_us, int32_t n_frames,
                       int64_t* out, int64_t* covariance, uint8_t* state) {
  ruffini::SaturationCounter saturations;
  for (int32_t t = 0; t < n_frames; ++t, features += wrench->n, out += 6, covariance += 21) {
    const auto said = wrench->map.run({features, wrench->n}, {}, capture_us[t], saturations);
    const ruffini::Wrench& w = said.wrench;
    const std::array<int64_t, 6> values{w.force_x_un,     w.force_y_un,     w.force_z_un,
                                        w.torque_x_un_um, w.torque_y_un_um, w.torque_z_un_um};
    std::copy(values.begin(), values.end(), out);
    std::copy(said.covariance.upper.begin(), said.covariance.upper.end(), covariance);
    state[t] = static_cast<uint8_t>((said.is_in_agreement ? 0 : 1) | (said.is_in_range ? 0 : 2));
  }
  return 0;
}

int ruffini_get_marker_quality(const ruffini_pipeline* pipeline, uint8_t* out) {
  if (!pipeline->path->are_markers_graded()) return fail("the markers of this board are not graded");
  for (const ruffini::Marker& m : pipeline->path->markers()) *out++ = m.quality;
  return 0;
}

int ruffini_get_change(const ruffini_pipeline* pipeline, int16_t* out) {
  const std::vector<ruffini::RelativeChange>& planes = pipeline->path->state().difference.change;
  const size_t n = planes.size() / 3;
  for (size_t i = 0; i < planes.size(); ++i) out[i] = planes[i % 3 * n + i / 3].raw();
  return 0;
}

int ruffini_get_slope(const ruffini_pipeline* pipeline, int16_t* out) {
  for (const ruffini::CellSlope& s : pipeline->path->state().photometric.slope) {
    *out++ = s.x.raw();
    *out++ = s.y.raw();
  }
  return 0;
}

int ruffini_get_depth(const ruffini_pipeline* pipeline, int16_t* out) {
  return copy_raw(pipeline->path->state().depth.cell, out);
}

int ruffini_get_displacement(const ruffini_pipeline* pipeline, int16_t* out) {
  for (const ruffini::NodeDisplacement& u : pipeline->path->state().displacement.node) {
    *out++ = u.x.raw();
    *out++ = u.y.raw();
    *out++ = u.z.raw();
  }
  return 0;
}

int ruffini_get_force(const ruffini_pipeline* pipeline, int32_t* out) {
  for (const ruffini::NodeForce& f : pipeline->path->state().solve.force) {
    *out++ = f.x;
    *out++ = f.y;
    *out++ = f.z;
  }
  return 0;
}

int ruffini_get_sigma(const ruffini_pipeline* pipeline, int32_t* sigma, int64_t* covariance) {
  const auto& uncertainty = pipeline->path->state().uncertainty;
  if (!uncertainty.is_stated) return fail("no uncertainty is stated: the calibration has no error model");
  for (const ruffini::NodeSigma& s : uncertainty.node) {
    *sigma++ = s.x;
    *sigma++ = s.y;
    *sigma++ = s.z;
  }
  const auto& stated = pipeline->path->state().covariance.wrench;
  std::copy(stated.upper.begin(), stated.upper.end(), covariance);
  return 0;
}

int ruffini_get_residual(ruffini_pipeline* pipeline, int32_t* out, int32_t* validity) {
  pipeline->path->find_residual();
  const auto& residual = pipeline->path->state().residual;
  if (residual.validity == ruffini::Validity::kNotMeasured) {
    return fail("no residual: the calibration has no second pass, or depth is not measured");
  }
  *validity = static_cast<int32_t>(residual.validity);
  std::copy(residual.node.begin(), residual.node.end(), out);
  return 0;
}

int ruffini_get_covariance(const ruffini_pipeline* pipeline, int64_t* covariance) {
  const auto& stated = pipeline->path->state().covariance;
  if (!stated.is_stated) return fail("no covariance is stated: the calibration has no error model");
  std::copy(stated.wrench.upper.begin(), stated.wrench.upper.end(), covariance);
  return 0;
}

int ruffini_get_targets(const ruffini_pipeline* pipeline, int64_t* out) {
  for (const ruffini::Target& t : pipeline->path->targets()) {
    for (const ruffini::DiscSight& s : {t.rest, t.now}) {
      for (const int64_t value : {s.x_q16, s.y_q16, s.area_q8, s.bright_q8}) *out++ = value;
    }
    *out++ = t.is_lost ? 1 : 0;
  }
  return 0;
}

int ruffini_get_touches(const ruffini_pipeline* pipeline, int64_t* out, int32_t* n) {
  const FramePath& path = *pipeline->path;
  if (!path.writes(ruffini::Slot::kSkin)) return fail("this board has no glowing skin: see [skin] in boards/README.md");
  const ruffini::SkinTouchList& list = path.state().skin.touches;
  *n = list.n_listed;
  for (size_t i = 0; i < static_cast<size_t>(*n); ++i) {
    const ruffini::SkinTouch& t = list.touch[i];
    const auto force = ruffini::pressing_vector_un(ruffini::on_skin(path.board().skin, t.x_um, t.y_um), t.press_un);
    const int64_t row[] = {int64_t{t.id},    t.x_um,           t.y_um,   t.area_um2, t.brightness_q2, t.press_un,
                           t.press_sigma_un, t.place_sigma_um, force[0], force[1],   force[2]};
    out = std::copy(std::begin(row), std::end(row), out);
  }
  return 0;
}

int ruffini_get_tip(const ruffini_pipeline* pipeline, int64_t* row) {
  if (!pipeline->path->writes(ruffini::Slot::kToolTouch))
    return fail("no fingertip is calibrated: see ruffini cal fit --only fingertip");
  const ruffini::TipTouch& t = pipeline->path->state().tip;
  for (const bool each : {t.is_touched, t.is_known, t.is_in_range}) *row++ = each ? 1 : 0;
  for (const int64_t each : {t.force_un, t.way_um, t.x_um, t.y_um, t.roll_urad, t.pitch_urad, t.area_um2})
    *row++ = each;
  row = std::copy(t.sigma.begin(), t.sigma.end(), row);
  *row++ = t.flat_um2;
  *row = t.flat_sigma_um2;
  return 0;
}

int ruffini_skin_state(const ruffini_pipeline* pipeline, int32_t* n_taxels, int64_t* light_age) {
  const FramePath& path = *pipeline->path;
  if (!path.writes(ruffini::Slot::kSkin)) return fail("this board has no glowing skin: see [skin] in boards/README.md");
  *n_taxels = static_cast<int32_t>(path.state().skin.ratio.size());
  light_age[0] = path.state().skin.light_q12;
  light_age[1] = path.state().skin.age_q12;
  return 0;
}

int ruffini_get_profile(const ruffini_pipeline* pipeline, int64_t* out) {
  if (!pipeline->path->writes(ruffini::Slot::kProfile))
    return fail("this board has no stage contact_model: see boards/README.md");
  const ruffini::Profile& p = pipeline->path->state().profile;
  out = std::copy(p.radial_q4.begin(), p.radial_q4.end(), out);
  for (const int64_t each : {p.size_q4, p.fall_q16, p.center_x_um, p.center_y_um, p.lost_1e3, p.flow_q4}) *out++ = each;
  return 0;
}

int ruffini_get_helmholtz(const ruffini_pipeline* pipeline, int64_t* out, int64_t* flow) {
  if (!pipeline->path->writes(ruffini::Slot::kHelmholtz))
    return fail("this board has no stage helmholtz: see boards/README.md");
  const ruffini::HelmholtzSums& s = pipeline->path->state().helmholtz;
  for (const int64_t each : {s.curl_free_q4, s.divergence_free_q4, s.twist_urad}) *out++ = each;
  if (flow == nullptr) return 0;
  for (const ruffini::FlowPoint& g : s.curl_free) {
    *flow++ = g.x_q4;
    *flow++ = g.y_q4;
  }
  return 0;
}

int ruffini_get_contact_model(const ruffini_pipeline* pipeline, int64_t* out) {
  if (!pipeline->path->writes(ruffini::Slot::kContactModel))
    return fail("the calibration has no contact model: make one with `ruffini cal fit --only contact`");
  const ruffini::FrameState& s = pipeline->path->state();
  const ruffini::ModelledContact& c = s.modelled;
  const int64_t row[] = {c.is_touched ? 1 : 0,
                         static_cast<int64_t>(c.kind),
                         c.sure_1e3,
                         c.gel_depth_um,
                         c.press_depth_um,
                         c.depth_sigma_um,
                         c.area_um2,
                         c.effective_area_um2,
                         c.stiffness_pa_um,
                         c.shore_q4,
                         c.shore_sigma_q4,
                         c.is_strange ? 1 : 0,
                         static_cast<int64_t>(s.modelled.depth_validity),
                         static_cast<int64_t>(s.modelled.hardness_validity),
                         c.mean_flow_um,
                         c.moment_by_flow_unmm};
  std::copy(std::begin(row), std::end(row), out);
  return 0;
}

int ruffini_get_taxels(const ruffini_pipeline* pipeline, int32_t* ratio) {
  if (!pipeline->path->writes(ruffini::Slot::kSkin))
    return fail("this board has no glowing skin: see [skin] in boards/README.md");
  const auto taxels = pipeline->path->state().skin.ratio;
  std::copy(taxels.begin(), taxels.end(), ratio);
  return 0;
}

int ruffini_get_glow(const ruffini_pipeline* pipeline, int16_t* out) {
  if (!pipeline->path->writes(ruffini::Slot::kSkin))
    return fail("this board has no glowing skin: see [skin] in boards/README.md");
  const auto plane = pipeline->path->state().skin.glow;
  std::copy(plane.begin(), plane.end(), out);
  return 0;
}

int ruffini_get_mask(const ruffini_pipeline* pipeline, uint8_t* out) {
  const auto mask = pipeline->path->state().solve.mask;
  std::copy(mask.begin(), mask.end(), out);
  return 0;
}

int ruffini_get_slip(const ruffini_pipeline* pipeline, uint8_t* out) {
  const auto nodes = pipeline->path->state().slip.node;
  std::transform(nodes.begin(), nodes.end(), out, [](ruffini::NodeSlip s) { return static_cast<uint8_t>(s); });
  return 0;
}

int ruffini_get_contacts(const ruffini_pipeline* pipeline, int64_t* out, int32_t* n) {
  const ruffini::FrameState& s = pipeline->path->state();
  *n = s.contacts.n_listed;
  for (size_t i = 0; i < static_cast<size_t>(*n); ++i) {
    const ruffini::Contact& c = s.contacts.contacts[i];
    const ruffini::ContactSlip& slip = s.slip.contact[i];
    const int64_t row[] = {c.n_nodes,      c.area_um2,        c.center_x_um,
                           c.center_y_um,  c.force_x_un,      c.force_y_un,
                           c.force_z_un,   c.peak_depth_nm,   static_cast<int64_t>(slip.state),
                           slip.ratio_1e3, slip.friction_1e3, slip.friction_sigma_1e3,
                           slip.share_1e3, slip.margin_un,    int64_t{c.reaches_border}};
    out = std::copy(std::begin(row), std::end(row), out);
  }
  return 0;
}
