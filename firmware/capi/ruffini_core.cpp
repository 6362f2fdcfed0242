#include "capi/ruffini_core.h"

#include <algorithm>
#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "board/parse.h"
#include "capi/slot_views.h"
#include "core/stages.h"
#include "frame_path.h"
#include "image/kernels.h"
#include "image/views.h"
#include "stages/feature_wrench/feature_wrench.h"

#ifndef RUFFINI_VERSION
#define RUFFINI_VERSION "0"
#endif

using ruffini::FramePath;

struct ruffini_pipeline {
  std::unique_ptr<FramePath> path;
  std::optional<ruffini::ViewMaps> views;  // of the calibration

  // Arrays whose slots the stages of this board write.
  [[nodiscard]] std::vector<const ruffini::SlotView*> arrays() const {
    std::vector<const ruffini::SlotView*> out;
    for (const ruffini::SlotView& view : ruffini::slot_views()) {
      if (path->writes(view.slot)) out.push_back(&view);
    }
    return out;
  }
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

}  // namespace

const char* ruffini_version(void) { return RUFFINI_VERSION; }

const char* ruffini_kernels(void) {
  return &ruffini::kernels::fastest_supported() == &ruffini::kernels::kScalar ? "scalar" : "vector";
}

const char* ruffini_error(void) { return last_error.c_str(); }

const char* ruffini_board_json(const char* toml, size_t toml_bytes, const char* where) {
  auto board = ruffini::board_json({toml, toml_bytes}, where);
  if (!board) return fail(board.error().message), nullptr;
  last_board = std::move(board).value();
  return last_board.c_str();
}

ruffini_pipeline* ruffini_open(const char* toml, size_t toml_bytes, const char* where, const uint8_t* calibration,
                               size_t calibration_bytes) {
  auto board = ruffini::parse_board({toml, toml_bytes}, where);
  if (!board) return fail(board.error().message), nullptr;
  std::shared_ptr<const ruffini::CalibrationFile> file;
  if (calibration != nullptr) {
    auto loaded = ruffini::CalibrationFile::load({calibration, calibration + calibration_bytes});
    if (!loaded) return fail(loaded.error().message), nullptr;
    // Offline there is no sensor whose serial number could differ: a file for one sensor is accepted.
    const ruffini::Calibration& offered = loaded.value()->get();
    const ruffini::Status fits = offered.check_target(board.value(), offered.text("sensor_serial"));
    if (!fits) return fail(fits.error().message), nullptr;
    file = loaded.value();
  }
  board.value().n_cores = 1;  // this library has one thread
  auto path = FramePath::configure(board.value(), file, now_ns);
  if (!path) return fail(path.error().message), nullptr;
  auto pipeline = std::make_unique<ruffini_pipeline>(std::move(path).value(), std::nullopt);
  if (file && file->get().has_kind("views")) {
    const ruffini::Status views = ruffini::keep(ruffini::ViewMaps::load(file->get(), board.value()), pipeline->views);
    if (!views) return fail(views.error().message), nullptr;
  }
  return pipeline.release();
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
          .n_contacts = s.contacts.n_found};
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
    const auto& solved = path.state().solve.force;
    for (size_t i = 0; i < n_nodes; ++i) {
      force[3 * i] = solved[i].x;
      force[3 * i + 1] = solved[i].y;
      force[3 * i + 2] = solved[i].z;
    }
  }
  return 0;
}

int ruffini_triangulate(const ruffini_pipeline* pipeline, const int32_t* places_q16, int32_t n, int32_t* out) {
  const auto& views = pipeline->views;
  if (!views)
    return fail("the calibration holds no views of this board: make them with `ruffini cal fit --only camera --views`");
  for (int32_t i = 0; i < n; ++i, places_q16 += 4, out += 4) {
    const ruffini::RayIntersection met =
        triangulate(views->at(0, places_q16[0], places_q16[1]), views->at(1, places_q16[2], places_q16[3]));
    const int64_t values[4] = {met.x_q8, met.y_q8, met.z_q8, met.gap_q8};
    std::transform(values, values + 4, out, [&](int64_t v) {
      return met.is_found ? static_cast<int32_t>(std::clamp<int64_t>(v, -INT32_MAX, INT32_MAX)) : INT32_MIN;
    });
  }
  return 0;
}

ruffini_wrench* ruffini_wrench_open(const uint8_t* calibration, size_t calibration_bytes, const char* features,
                                    int32_t n) {
  auto file = ruffini::CalibrationFile::load({calibration, calibration + calibration_bytes});
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

int32_t ruffini_slot_count(const ruffini_pipeline* pipeline) { return static_cast<int32_t>(pipeline->arrays().size()); }

int ruffini_slot_describe(const ruffini_pipeline* pipeline, int32_t index, ruffini_slot_t* out) {
  const auto all = pipeline->arrays();
  if (index < 0 || index >= std::ssize(all)) {
    return fail("slot " + std::to_string(index) + " of " + std::to_string(all.size()) + ": count from 0");
  }
  const ruffini::SlotView& view = *all[static_cast<size_t>(index)];
  const ruffini::ArrayShape shape = view.shape(*pipeline->path);
  *out = {.name = view.name,
          .type = view.type,
          .unit = view.unit_of != nullptr ? view.unit_of(*pipeline->path) : view.unit,
          .columns = view.columns,
          .n_axes = shape.n_axes,
          .shape = {static_cast<int32_t>(shape.size[0]), static_cast<int32_t>(shape.size[1]),
                    static_cast<int32_t>(shape.size[2])}};
  return 0;
}

int ruffini_get_slot(ruffini_pipeline* pipeline, const char* name, void* out, size_t out_bytes, int32_t* n_rows) {
  const auto all = pipeline->arrays();
  const auto found = std::find_if(all.begin(), all.end(),
                                  [&](const ruffini::SlotView* view) { return std::string_view(view->name) == name; });
  if (found == all.end()) {
    std::string list;
    for (const ruffini::SlotView* view : all) list += (list.empty() ? "" : ", ") + std::string(view->name);
    return fail("this board with this calibration has no slot \"" + std::string(name) + "\": it has " +
                (list.empty() ? "none" : list));
  }
  const ruffini::SlotView& view = **found;
  const size_t needed = view.shape(*pipeline->path).count() * view.value_bytes();
  if (out_bytes < needed) {
    return fail("slot \"" + std::string(name) + "\" takes " + std::to_string(needed) + " bytes, the buffer has " +
                std::to_string(out_bytes) + ": ask ruffini_slot_describe for its shape");
  }
  if (const std::string_view absence = view.absence(*pipeline->path); !absence.empty()) {
    return fail("slot \"" + std::string(name) + "\" is not valid: " + std::string(absence) +
                "; see which tables the calibration has, and whether depth is measured");
  }
  *n_rows = static_cast<int32_t>(view.copy(*pipeline->path, out));
  return 0;
}

int ruffini_features(const ruffini_pipeline* pipeline, ruffini_features_t* out) {
  const auto& features = pipeline->path->state().features;
  *out = {.sort = features.sort.name.empty() ? "" : features.sort.name.data(),
          .n = static_cast<int32_t>(features.value.size()),
          .n_planes = features.n_planes,
          .n_y = features.cells.n_y,
          .n_x = features.cells.n_x};
  return 0;
}

int32_t ruffini_stage_count(void) { return static_cast<int32_t>(ruffini::stage_names().size()); }

const char* ruffini_stage_name(int32_t index) {
  static const std::vector<std::string> names = ruffini::stage_names();
  if (index < 0 || index >= std::ssize(names)) {
    return fail("stage " + std::to_string(index) + " of " + std::to_string(names.size()) + ": count from 0"), nullptr;
  }
  return names[static_cast<size_t>(index)].c_str();
}

const char* ruffini_stage_writes(int32_t index) {
  static const std::vector<std::string> writes = [] {
    std::vector<std::string> all;
    for (const std::string& name : ruffini::stage_names()) {
      const ruffini::SlotSet slots = ruffini::stage_table()[ruffini::stage_row(name)].writes;
      std::string& out = all.emplace_back();
      for (size_t i = 0; i < ruffini::kSlotCount; ++i) {
        const auto slot = static_cast<ruffini::Slot>(i);
        if (slots.has(slot)) out += (out.empty() ? "" : " ") + std::string(slot_name(slot));
      }
    }
    return all;
  }();
  return ruffini_stage_name(index) == nullptr ? nullptr : writes[static_cast<size_t>(index)].c_str();
}

int ruffini_stage_times(const ruffini_pipeline* pipeline, uint64_t* ns) {
  for (const std::string& name : ruffini::stage_names()) {
    *ns++ = pipeline->path->state().stage_ns[ruffini::stage_row(name)];
  }
  return 0;
}
