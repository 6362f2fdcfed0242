// C door on single stages of the core, for the bit-exact comparison with the numpy mirror.
//
// The product's own door (firmware/capi) gives whole frames; here each stage takes arbitrary inputs.
// Arrays are dense and row-major; fixed-point values travel as their raw integers.
#include <algorithm>
#include <array>
#include <cstring>
#include <memory>
#include <optional>
#include <vector>

#include "base/ambient.h"
#include "board/parse.h"
#include "estimators/camera_motion.h"
#include "frame_calibration.h"
#include "image/block_edges.h"
#include "image/difference.h"
#include "image/displacement.h"
#include "image/dots.h"
#include "image/markers.h"
#include "image/photometric.h"
#include "image/pixel_statistics.h"
#include "image/poisson.h"
#include "image/printed_markers.h"
#include "image/rest.h"
#include "image/slipped_pins.h"
#include "image/slipped_rows.h"
#include "image/texture_flow.h"
#include "image/trigonometry.h"
#include "stages/contacts/contacts.h"
#include "stages/contacts/slip.h"
#include "stages/feature_wrench/corner_motion.h"
#include "stages/feature_wrench/feature_wrench.h"
#include "stages/fingertip/rim_motion.h"

namespace {

using namespace ruffini;

struct Stages {
  explicit Stages(BoardSettings settings)
      : board(std::move(settings)),
        rest(board.camera.width_px, board.camera.height_px, board.n_rest_frames),
        dots(dot_parameters(board)),
        lattice(board),
        poisson(board),
        displacement(board),
        contacts(NodeGrid{board}, board.force_lsb_un, board.contact.threshold_un / board.force_lsb_un),
        slip(NodeGrid{board}, board.force_lsb_un) {}

  BoardSettings board;
  Rest rest;
  DotDetector dots;
  MarkerTracker lattice;
  std::optional<Photometric> photometric;
  Poisson poisson;
  Displacement displacement;
  ContactFinder contacts;
  SlipTracker slip;
};

// Markers as rows of x, y, dx, dy, is_lost, is_absent.
constexpr int kMarkerColumns = 6;

void put_markers(std::span<const Marker> markers, int32_t* out) {
  for (const Marker& m : markers) {
    const int32_t row[kMarkerColumns] = {m.rest_x.raw(),         m.rest_y.raw(),    m.displacement_x.raw(),
                                         m.displacement_y.raw(), m.is_lost ? 1 : 0, m.is_absent ? 1 : 0};
    out = std::copy(std::begin(row), std::end(row), out);
  }
}

std::vector<Marker> get_markers(const int32_t* rows, int n) {
  std::vector<Marker> markers(static_cast<size_t>(n));
  for (Marker& m : markers) {
    m.rest_x = ImagePx::from_raw(rows[0]);
    m.rest_y = ImagePx::from_raw(rows[1]);
    m.displacement_x = ImagePx::from_raw(rows[2]);
    m.displacement_y = ImagePx::from_raw(rows[3]);
    m.is_lost = rows[4] != 0;
    m.is_absent = rows[5] != 0;
    rows += kMarkerColumns;
  }
  return markers;
}

std::vector<Dot> get_dots(const int32_t* rows, int n) {
  std::vector<Dot> dots(static_cast<size_t>(n));
  for (Dot& dot : dots) {
    dot = {ImagePx::from_raw(rows[0]), ImagePx::from_raw(rows[1]), rows[2]};
    rows += 3;
  }
  return dots;
}

FrameView view(const Stages& stages, const uint8_t* bgr) {
  const CameraSettings& camera = stages.board.camera;
  return {bgr, camera.width_px, camera.height_px, 3, ptrdiff_t{3} * camera.width_px};
}

size_t n_pixels(const Stages& stages) {
  return static_cast<size_t>(stages.board.camera.width_px) * static_cast<size_t>(stages.board.camera.height_px);
}

}  // namespace

extern "C" {

// Null when the board does not parse; `error` (256 bytes) then says why.
Stages* stages_open(const char* board_toml, char* error) {
  Result<BoardSettings> board = parse_board(board_toml, "board");
  if (!board) {
    std::strncpy(error, board.error().message.c_str(), 255);
    error[255] = 0;
    return nullptr;
  }
  return new Stages(std::move(board).value());
}

void stages_close(Stages* stages) { delete stages; }

void stages_take_ambient_away(uint8_t* lit, const uint8_t* dark, int n) {
  take_ambient_away({lit, static_cast<size_t>(n)}, {dark, static_cast<size_t>(n)});
}

int32_t stages_cos_pi_q30(int64_t numerator, int64_t denominator) { return cos_pi_q30(numerator, denominator); }

// `reciprocal`: planes of B, G and R.
int stages_rest(Stages* stages, const uint8_t* frames, int n_frames, uint16_t* image, int16_t* reciprocal) {
  stages->rest.restart(n_frames);
  bool is_complete = false;
  for (int i = 0; i < n_frames; ++i) {
    is_complete = stages->rest.add(view(*stages, frames + static_cast<size_t>(i) * 3 * n_pixels(*stages)));
  }
  std::ranges::copy(stages->rest.image(), image);
  std::ranges::copy(stages->rest.reciprocal(), reciprocal);
  return is_complete ? 1 : 0;
}

// Against the rest that stages_rest learned. `out`: planes of B, G and R; `counts`: dark, full.
void stages_difference(Stages* stages, const uint8_t* frame, int16_t* out, uint16_t* grey, int32_t* counts) {
  std::vector<RelativeChange> change(3 * n_pixels(*stages));
  const ExposureCounts exposure = difference(view(*stages, frame), stages->rest, change, {grey, n_pixels(*stages)});
  std::ranges::transform(change, out, [](RelativeChange d) { return d.raw(); });
  counts[0] = exposure.dark;
  counts[1] = exposure.full;
}

// Rows of x, y, area; `out` has room for DotDetector::kMaxDots. Returns their number.
int stages_dots(Stages* stages, const uint16_t* grey, int32_t* out) {
  const std::span<const Dot> dots = stages->dots.detect({grey, n_pixels(*stages)});
  for (const Dot& dot : dots) {
    *out++ = dot.x.raw();
    *out++ = dot.y.raw();
    *out++ = dot.area_px;
  }
  return static_cast<int>(dots.size());
}

int stages_learn_markers(Stages* stages, const int32_t* dots, int n_dots, int32_t* markers) {
  const int n_found = stages->lattice.learn(get_dots(dots, n_dots));
  put_markers(stages->lattice.markers(), markers);
  return n_found;
}

int stages_track_markers(Stages* stages, const int32_t* dots, int n_dots, const int64_t* error2_q16, int32_t* markers) {
  const size_t n = stages->lattice.assign(get_dots(dots, n_dots)).size();
  const int n_lost = stages->lattice.finish({error2_q16, n});
  put_markers(stages->lattice.markers(), markers);
  return n_lost;
}

// Learns from `rest`, tracks one frame: rows of markers of it, their quality. Returns how many are lost.
int stages_printed(Stages* stages, const uint16_t* rest_grey, const uint16_t* rest, const uint16_t* grey,
                   const uint8_t* frame, int32_t* markers, uint8_t* quality) {
  PrintedMarkers printed(stages->board);
  printed.learn({rest_grey, n_pixels(*stages)}, {rest, 3 * n_pixels(*stages)});
  const int n_lost = printed.track({grey, n_pixels(*stages)}, view(*stages, frame));
  put_markers(printed.markers(), markers);
  for (const Marker& m : printed.markers()) *quality++ = m.quality;
  return n_lost;
}

// Of the markers tracked last.
void stages_marker_quality(Stages* stages, uint8_t* out) {
  for (const Marker& m : stages->lattice.markers()) *out++ = m.quality;
}

// Learns from `rest` (1/16 levels) and its grey, tracks one frame and its grey: rows of markers of both. Returns how many
// were found and lost.
void stages_flow(Stages* stages, const uint16_t* rest, const uint16_t* rest_grey, const uint8_t* frame,
                 const uint16_t* grey, int32_t* learned, int32_t* tracked, uint8_t* quality, int32_t* counts) {
  TextureFlow flow(stages->board);
  const CameraSettings& camera = stages->board.camera;
  counts[0] = flow.learn({rest_grey, n_pixels(*stages)}, {rest, 3 * n_pixels(*stages)});
  put_markers(flow.markers(), learned);
  const FrameView view{frame, camera.width_px, camera.height_px, 3, ptrdiff_t{3} * camera.width_px};
  counts[1] = flow.track({grey, n_pixels(*stages)}, view);
  put_markers(flow.markers(), tracked);
  for (const Marker& m : flow.markers()) *quality++ = m.quality;
}

// `bend_axis`: 3 first lines and 3 shifts, with `bend`; both may be null.
void stages_set_photometric(Stages* stages, const int16_t* unmix, int n_cells_x, int n_cells_y, const int16_t* slope,
                            const int16_t* bend, const int32_t* bend_axis) {
  PhotometricTable table;
  table.cells = {n_cells_x, n_cells_y};
  table.unmix = {unmix, static_cast<size_t>(table.cells.count()) * 6};
  table.slope = {slope, size_t{Photometric::kSlopeSize} * Photometric::kSlopeSize * 2};
  table.is_balanced = true;
  if (bend != nullptr) {
    constexpr size_t n = Photometric::kBendSize;
    table.bend = {bend, n * n * n * 2};
    std::copy_n(bend_axis, 3, table.bend_low_q12.begin());
    std::copy_n(bend_axis + 3, 3, table.bend_shift.begin());
  }
  stages->photometric.emplace(stages->board, table);
}

// `difference_q12`: planes of B, G and R; `level_q16` of the light: 3.
void stages_photometric(Stages* stages, const int16_t* difference_q12, const int32_t* markers, const int32_t* level_q16,
                        int16_t* out) {
  std::vector<RelativeChange> change(3 * n_pixels(*stages));
  for (size_t i = 0; i < change.size(); ++i) change[i] = RelativeChange::from_raw(difference_q12[i]);
  std::vector<CellSlope> slope(static_cast<size_t>(stages->photometric->cells().count()));
  const LightLevel level = {level_q16[0], level_q16[1], level_q16[2]};
  stages->photometric->run(change, get_markers(markers, stages->board.markers.lattice.count()), level, slope);
  for (const CellSlope& s : slope) {
    *out++ = s.x.raw();
    *out++ = s.y.raw();
  }
}

// Depth of a skin that darkens, by a balanced table of 257 lines.
void stages_intensity(Stages* stages, const int16_t* depth_table, const int16_t* difference_q12,
                      const int32_t* level_q16, int16_t* out) {
  PhotometricTable table;
  table.depth = {depth_table, size_t{PhotometricTable::kDepthSize}};
  table.is_balanced = true;
  Photometric stage(stages->board, table);
  std::vector<RelativeChange> change(3 * n_pixels(*stages));
  for (size_t i = 0; i < change.size(); ++i) change[i] = RelativeChange::from_raw(difference_q12[i]);
  std::vector<DisplacementUm> depth(static_cast<size_t>(stage.cells().count()));
  stage.run_depth(change, {level_q16[0], level_q16[1], level_q16[2]}, depth);
  for (const DisplacementUm& z : depth) *out++ = z.raw();
}

// Returns the saturations.
int64_t stages_poisson(Stages* stages, const int16_t* slope_q12, int16_t* depth_q3) {
  const int step = stages->board.depth.step_px;
  std::vector<CellSlope> slope(n_pixels(*stages) / static_cast<size_t>(step * step));
  for (size_t i = 0; i < slope.size(); ++i) {
    slope[i] = {Slope::from_raw(slope_q12[2 * i]), Slope::from_raw(slope_q12[2 * i + 1])};
  }
  std::vector<DisplacementUm> depth(slope.size());
  SaturationCounter saturations;
  stages->poisson.run(slope, depth, saturations);
  std::ranges::transform(depth, depth_q3, [](DisplacementUm z) { return z.raw(); });
  return static_cast<int64_t>(saturations.count);
}

// `n_depth` = 0: depth not measured. Returns the saturations.
int64_t stages_displacement(Stages* stages, const int32_t* markers, const int16_t* depth_q3, int n_depth,
                            int16_t* out) {
  std::vector<DisplacementUm> depth(static_cast<size_t>(n_depth));
  for (size_t i = 0; i < depth.size(); ++i) depth[i] = DisplacementUm::from_raw(depth_q3[i]);
  const std::vector<Marker> lattice = get_markers(markers, stages->board.markers.lattice.count());
  std::vector<NodeDisplacement> nodes(static_cast<size_t>(stages->displacement.nodes().count()));
  SaturationCounter saturations;
  stages->displacement.learn(lattice);
  stages->displacement.run(lattice, depth, nodes, saturations);
  for (const NodeDisplacement& u : nodes) {
    *out++ = u.x.raw();
    *out++ = u.y.raw();
    *out++ = u.z.raw();
  }
  return static_cast<int64_t>(saturations.count);
}

void stages_filled(Stages* stages, const int32_t* markers, uint8_t* out) {
  const std::vector<Marker> lattice = get_markers(markers, stages->board.markers.lattice.count());
  stages->displacement.learn(lattice);
  stages->displacement.mark_filled(lattice, {out, static_cast<size_t>(stages->displacement.nodes().count())});
}

// `out` has a row a listed contact: state, ratio, friction, sigma, share, margin. Returns how many.
int stages_slip(void* handle, const uint8_t* mask, const int32_t* force, const int16_t* displacement, uint8_t* plane,
                int64_t* out) {
  auto& stages = *static_cast<Stages*>(handle);
  const auto n = static_cast<size_t>(NodeGrid{stages.board}.size().count());
  std::vector<NodeForce> f(n);
  std::vector<NodeDisplacement> u(n);
  using Um = DisplacementUm;
  for (size_t i = 0; i < n; ++i, force += 3, displacement += 3) {
    f[i] = {force[0], force[1], force[2]};
    u[i] = {Um::from_raw(displacement[0]), Um::from_raw(displacement[1]), Um::from_raw(displacement[2])};
  }
  const ContactList list = stages.contacts.find({mask, n}, f, u);
  stages.slip.track(list, stages.contacts.component(), f, u);
  std::transform(stages.slip.nodes().begin(), stages.slip.nodes().end(), plane,
                 [](NodeSlip s) { return static_cast<uint8_t>(s); });
  for (size_t i = 0; i < static_cast<size_t>(list.n_listed); ++i) {
    const ContactSlip& s = stages.slip.contacts()[i];
    const int64_t row[] = {static_cast<int64_t>(s.state), s.ratio_1e3, s.friction_1e3,
                           s.friction_sigma_1e3,          s.share_1e3, s.margin_un};
    out = std::copy(std::begin(row), std::end(row), out);
  }
  return list.n_listed;
}

int stages_slipped_rows(int n_x, int n_y, const int32_t* markers, int are_patches) {
  const RowsOf what = are_patches != 0 ? RowsOf::kPatches : RowsOf::kDots;
  return has_slipped_rows(get_markers(markers, n_x * n_y), {n_x, n_y}, what) ? 1 : 0;
}

// `rest`, `now`: as those of stages_rim_motion.
int stages_slipped_pins(int n, int n_views, int height, const int32_t* rest, const int32_t* now) {
  SlippedPins pins(height);
  pins.learn(get_markers(rest, n), static_cast<size_t>(n_views));
  return pins.run(get_markers(now, n)) ? 1 : 0;
}

// Of each of `n` frames: 1 coarse, 2 off the curve. `rest`: the image; `rest_frames`: whose ties count.
void stages_pixel_statistics(int width, int height, const uint8_t* rest_frames, int n_rest, const uint16_t* rest,
                             const int32_t* gain, const uint8_t* frames, int n, int32_t* out) {
  const size_t n_values = size_t{3} * static_cast<size_t>(width * height);
  const auto view = [&](const uint8_t* pixels) { return FrameView{pixels, width, height, 3, ptrdiff_t{3} * width}; };
  PixelStatistics statistics(width, height);
  for (int i = 0; i < n_rest; ++i) statistics.add_rest(view(rest_frames + static_cast<size_t>(i) * n_values));
  statistics.learn({rest, n_values});
  for (int i = 0; i < n; ++i) {
    const auto said = statistics.run(view(frames + static_cast<size_t>(i) * n_values), {gain[0], gain[1], gain[2]});
    out[i] = (said.is_coarse ? 1 : 0) + (said.is_off_curve ? 2 : 0);
  }
}

// Of each of `n` frames: 1 with blocks that the rest frames did not have.
void stages_block_edges(int width, int height, const uint8_t* rest_frames, int n_rest, const uint8_t* frames, int n,
                        int32_t* out) {
  const size_t n_values = size_t{3} * static_cast<size_t>(width * height);
  const auto view = [&](const uint8_t* pixels) { return FrameView{pixels, width, height, 3, ptrdiff_t{3} * width}; };
  BlockEdges blocks(width, height);
  for (int i = 0; i < n_rest; ++i) blocks.add_rest(view(rest_frames + static_cast<size_t>(i) * n_values));
  for (int i = 0; i < n; ++i) out[i] = blocks.run(view(frames + static_cast<size_t>(i) * n_values)) ? 1 : 0;
}

// `residual`: of every unknown; `force_un`: x, y and z.
int stages_camera_moved(int n_x, int n_y, const int32_t* residual, const uint8_t* mask, const int64_t* force_un) {
  const GridSize size{n_x, n_y};
  const CameraMotion motion(size);
  std::vector<int32_t> at_sides;
  for (const uint32_t j : motion.unknowns()) at_sides.push_back(residual[j]);
  const Wrench wrench{.force_x_un = force_un[0], .force_y_un = force_un[1], .force_z_un = force_un[2]};
  return motion.has_moved(at_sides, {mask, static_cast<size_t>(size.count())}, wrench) ? 1 : 0;
}

// `out`: shift x, y (px Q16), turn, zoom (Q20) that the corners have in common, and whether that counts as moved; -1 where
// the calibration has no wrench of such markers. The places at rest are those of `markers`.
int stages_corner_motion(const uint8_t* calibration, int n_bytes, int n_x, int n_y, const int32_t* markers,
                         const int64_t* force_un, int64_t* out) {
  const auto file = CalibrationFile::load({calibration, calibration + n_bytes});
  if (!file) return -1;
  const auto wrench = FeatureWrench::load(file.value()->get(), "markers", 2 * n_x * n_y);
  if (!wrench) return -1;
  const auto shown = get_markers(markers, n_x * n_y);
  CornerMotion corners({n_x, n_y});
  corners.learn(shown, wrench.value());
  const CornerMotion::Motion seen = corners.motion(shown);
  std::copy_n(std::array{seen.shift_x_q16, seen.shift_y_q16, seen.turn_q20, seen.zoom_q20}.begin(), 4, out);
  const Wrench forces{.force_x_un = force_un[0], .force_y_un = force_un[1], .force_z_un = force_un[2]};
  return corners.has_moved(shown, forces) ? 1 : 0;
}

// `out`: shift x, y, zoom and turn (px Q16) that the sectors of a view's rim have in common.
// `at_max`: shift and zoom.
int stages_rim_motion(int n, const int32_t* rest, const int32_t* now, int64_t force_un, int64_t most_un,
                      const int64_t* at_max, int64_t* out) {
  RimMotion rim({.shift_q16 = at_max[0], .zoom_q16 = at_max[1]});
  rim.learn(get_markers(rest, n));
  const auto shown = get_markers(now, n);
  const RimMotion::Motion seen = rim.motion(shown);
  std::copy_n(std::array{seen.shift_x_q16, seen.shift_y_q16, seen.zoom_q16, seen.turn_q16}.begin(), 4, out);
  return rim.has_moved(shown, force_un, most_un) ? 1 : 0;
}

void stages_slip_forget(void* handle) { static_cast<Stages*>(handle)->slip.forget(); }

}  // extern "C"
