#include "frame_path.h"

#include <algorithm>
#include <cstdlib>
#include <utility>

#include "image/pitch_check.h"

namespace ruffini {
namespace {

// Light that for so many frames was further than 0.05 % from what is followed (image/light.h takes a sixteenth a frame)
// makes depth that a faint touch cannot be told from. A touch moves it less, or begins earlier.
constexpr int32_t kDriftGain = Rest::kUnitGain / 32'768;
constexpr int kDriftFrames = 8;

// What a strong press can do to a frame. Where one of these comes up while rest is learned, something has come onto the pad.
constexpr uint32_t kByPress = kFlagMarkersLost | kFlagSaturated | kFlagOverRange | kFlagFeatures | kFlagLight;

// The grid of depth is that of [depth], unless a stage has its own.
FrameState first_state(const BoardSettings& board) {
  FrameState state;
  state.depth.step_px = board.depth.step_px;
  state.depth.grid = {board.camera.width_px / board.depth.step_px, board.camera.height_px / board.depth.step_px};
  state.depth.cell.resize(static_cast<size_t>(state.depth.grid.count()));
  return state;
}

}  // namespace

// The life of a frame. Stage by stage: firmware/README.md.
const FrameState& FramePath::process(const FrameView& frame, uint64_t capture_us) {
  state_.flags = capture_flags_;
  state_.stage_ns.fill(0);
  state_.uncertainty.is_stated = state_.covariance.is_stated = false;
  state_.solve.is_refined = false;
  state_.solve.is_explained = true;
  state_.residual.validity = Validity::kNotMeasured;
  const uint64_t saturations_before = state_.saturations.count;
  if (!rest_.is_ready()) state_.flags |= kFlagNoReference;
  if (rest_watch_.is_unverified) state_.flags |= kFlagRestUnverified;
  if (rest_.is_ready() || rest_.is_learned_anew()) measure(frame, capture_us);
  rest_.is_ready() ? verify_rest() : learn_watched(frame);
  if (state_.saturations.count != saturations_before) state_.flags |= kFlagSaturated;
  judge();
  return state_;
}

template <typename Work>
void FramePath::timed(StageId stage, Work work) {
  if (!has(stage)) return;
  const uint64_t start = clock_();
  work();
  state_.stage_ns[static_cast<size_t>(stage)] = clock_() - start;
}

// Against the rest in force, also while another one is learned: then kFlagNoReference makes it invalid.
void FramePath::measure(const FrameView& frame, uint64_t capture_us) {
  make_grey(frame);
  watch(frame);
  timed(StageId::kMarkers, [&] { run_markers(frame); });
  timed(StageId::kTargets, [&] { run_targets(); });
  follow_light();
  run_depth();
  timed(StageId::kDisplacement, [&] { run_displacement(); });
  judge_input();
  follow_zero(capture_us);
  run_solve(depth_is_trusted());
  run_memory(capture_us);
  Frame on_its_way = frame_of(frame, capture_us);
  pipeline_.run(on_its_way);
  run_uncertainty();
}

Frame FramePath::frame_of(const FrameView& view, uint64_t capture_us) {
  return {.view = view,
          .capture_us = capture_us,
          .warmth = warmth_,
          .flags = state_.flags,
          .saturations = state_.saturations};
}

// After measure() by the rest of before, where there is one.
void FramePath::learn_watched(const FrameView& frame) {
  const uint32_t seen_flags = state_.flags & ~kFlagNoReference;
  const bool has_changed = rest_watch_.is_asked && (seen_flags & ~rest_watch_.flags_before & kByPress) != 0;
  if (rest_.is_learned_anew() && rest_watch_.is_watched && (has_changed || presses(seen_flags))) {
    rest_.give_up();
    if (!rest_watch_.is_asked) rest_watch_.is_unverified = rest_watch_.is_of_before = true;
    ++rest_watch_.n_refused;
    forget();
    return;
  }
  const bool can_feel = forces_.is_measured() || writes(Slot::kWrench);
  rest_watch_.is_seen = rest_watch_.is_seen && can_feel && rest_.is_learned_anew() && (seen_flags & kWrongFlags) == 0;
  learn(frame);
  if (!rest_.is_ready()) return;
  const bool is_known = rest_watch_.is_asked || rest_watch_.is_seen;
  rest_watch_.is_unverified = rest_watch_.is_expected && !is_known;
  rest_watch_.is_of_before = false;
  if (is_known) ++rest_watch_.n_known;
}

// A start that was refused under a load, or because pad or camera are no longer those of the run before: a pad that reads
// untouched by the rest of before tells them apart.
void FramePath::verify_rest() {
  RestWatch& watch = rest_watch_;
  if (!watch.is_unverified || !watch.is_of_before) return;
  const bool is_untouched = !is_wrong() && !presses(state_.flags);
  watch.n_untouched = is_untouched ? watch.n_untouched + 1 : 0;
  if (watch.n_untouched >= board_.n_rest_frames) watch.is_unverified = false;
}

void FramePath::learn(const FrameView& frame) {
  if (is_live_) {
    if (!rest_.is_learned_anew()) picture_watch_.old.run(frame);  // measure() did otherwise
    picture_watch_.add_rest(frame);
  }
  if (!rest_.add(frame)) return;
  warmth_.rest_mc = warmth_.now_mc;
  learn_features();
}

void FramePath::learn_features() {
  picture_watch_.learn(rest_.image());
  zero_follower_.forget();
  light_.learn(rest_.image(), photometric_.has_value());
  if (has(StageId::kMarkers) || has(StageId::kTargets)) learn_markers();
  pipeline_.learn(rest_.image());
}

void FramePath::learn_markers() {
  const std::span<const uint16_t> rest = rest_.image();
  for (size_t i = 0; i < state_.difference.grey.size(); ++i) {
    // As of a frame (image/difference.h), from 1/16 levels.
    const int sum = rest[3 * i] + 2 * rest[3 * i + 1] + rest[3 * i + 2];
    state_.difference.grey[i] = static_cast<uint16_t>((3 * sum + 2) >> 2);
  }
  const std::span<const uint16_t> grey = state_.difference.grey;
  if (has(StageId::kTargets)) targets_.learn(grey);
  if (!has(StageId::kMarkers)) return;
  if (flow_) {
    state_.markers.n_at_rest = flow_->learn(grey, rest);
  } else {
    state_.markers.n_at_rest = printed_.learn(grey, rest);
    // Of twice as many dots, every second one would do.
    is_other_pad_ = (!camera_map_ && !pitch_fits(markers(), board_)) ||
                    printed_.n_dots_at_rest() > 2 * board_.markers.lattice.count();
  }
  if (!board_.markers.has_views) displacement_.learn(markers());
  for (size_t i = 0; i < state_.markers.view.size(); ++i) {
    state_.markers.view[i].was_seen_at_rest = printed_.was_seen_at_rest(i);
  }
  publish_markers();
}

void FramePath::publish_markers() {
  state_.markers.marker = markers();
  if (!board_.markers.has_views) return;
  for (size_t i = 0; i < state_.markers.view.size(); ++i) state_.markers.view[i].n_unsure = printed_.n_unsure(i);
}

void FramePath::run_difference(const FrameView& frame) {
  state_.difference.exposure = difference(frame, rest_, state_.difference.change, state_.difference.grey);
}

// The difference makes it.
void FramePath::make_grey(const FrameView& frame) {
  timed(StageId::kDifference, [&] { run_difference(frame); });
  const bool is_needed = has(StageId::kMarkers) || has(StageId::kTargets);
  if (!has(StageId::kDifference) && is_needed) run_difference(frame);
}

void FramePath::run_markers(const FrameView& frame) {
  const std::span<const uint16_t> grey = state_.difference.grey;
  state_.markers.n_lost = flow_ ? flow_->track(grey, frame) : printed_.track(grey, frame);
  publish_markers();
}

void FramePath::run_targets() {
  state_.targets.n_lost = targets_.track(state_.difference.grey);
  if (targets_.is_light_off()) state_.flags |= kFlagLight;
  const auto px = [](int64_t q16) { return ImagePx::from_raw(static_cast<int32_t>(q16)); };
  std::transform(targets().begin(), targets().end(), target_marks_.begin(), [&](const Target& t) {
    return Marker{.rest_x = px(t.rest.x_q16),
                  .rest_y = px(t.rest.y_q16),
                  .displacement_x = px(t.now.x_q16 - t.rest.x_q16),
                  .displacement_y = px(t.now.y_q16 - t.rest.y_q16),
                  .is_lost = t.is_lost};
  });
}

// From the next frame on; this one is as it was compared. Its time counts as the difference's.
void FramePath::follow_light() {
  if (!photometric_ && !has(StageId::kTargets)) return;
  const uint64_t start = clock_();
  const Rest::Gain before = light_.gain();
  light_.run(state_.difference.change, hidden(), rest_);
  const bool is_balanced = photometric_ && photometric_->is_balanced();
  const bool has_settled = std::equal(before.begin(), before.end(), light_.gain().begin(),
                                      [](int32_t a, int32_t b) { return std::abs(a - b) < kDriftGain; });
  n_drifting_ = has_settled || is_balanced ? 0 : std::min(n_drifting_ + 1, kDriftFrames);
  const auto& touched = state_.solve.mask;  // by the frame before: what has begun goes on
  is_light_steady_ =
      n_drifting_ < kDriftFrames || std::any_of(touched.begin(), touched.end(), [](uint8_t m) { return m != 0; });
  if (is_balanced ? !light_.level_is_sure() || light_.map().is_off() : light_.is_off()) state_.flags |= kFlagLight;
  const int daylight_q12 = has_targets() ? LightTracker::kTiltedQ12 : LightTracker::kDaylightQ12;
  const LightLevel usual = is_balanced ? light_.level() : LightLevel{};
  if (light_.is_lit_from_outside(daylight_q12, usual)) state_.flags |= kFlagLight;
  if (photometric_ && !photometric_->is_of_depth() && light_.is_lit_from_one_side()) state_.flags |= kFlagLight;
  state_.stage_ns[static_cast<size_t>(StageId::kDifference)] += clock_() - start;
}

void FramePath::run_depth() {
  if (!photometric_) return;
  if (photometric_->is_of_depth()) {
    timed(StageId::kPhotometric,
          [&] { photometric_->run_depth(state_.difference.change, light_.level(), state_.depth.cell); });
    return;
  }
  timed(StageId::kPhotometric, [&] {
    photometric_->run(state_.difference.change, hidden(), light_.level(), state_.photometric.slope);
    if (camera_map_) camera_map_->rectify(state_.photometric.slope);
  });
  SaturationCounter& saturations = light_is_trusted() ? state_.saturations : untrusted_saturations_;
  timed(StageId::kPoisson, [&] { poisson_.run(state_.photometric.slope, state_.depth.cell, saturations); });
}

void FramePath::run_displacement() {
  // A table of other optics gives a depth to look at, not one to make forces of.
  const bool is_measured = light_is_trusted();
  displacement_.run(
      markers(), is_measured ? std::span<const DisplacementUm>(state_.depth.cell) : std::span<const DisplacementUm>(),
      state_.displacement.node, state_.saturations);
  if (depth_gauge_ && is_measured) {
    depth_gauge_->run(state_.displacement.node, state_.depth.cell, state_.saturations);
  }
  if (marker_depth_) marker_depth_->run(state_.displacement.node, state_.saturations);
  displacement_.mark_filled(markers(), state_.displacement.is_filled);
}

// Its time counts as the second pass's.
void FramePath::run_uncertainty() {
  if (!state_.uncertainty.is_stated) return;
  const uint64_t start = clock_();
  if (state_.solve.is_refined && forces_.has_camera_moved(state_.solve, state_.wrench.sum))
    state_.flags |= kFlagFeatures;
  const std::span<const uint8_t> is_filled = state_.displacement.is_filled;
  forces_.state_sigma(state_.solve, is_filled, state_.uncertainty.node);
  state_.covariance.wrench = forces_.state_covariance(state_.solve, is_filled, state_.wrench.sum, state_.contacts);
  state_.stage_ns[static_cast<size_t>(StageId::kSupport)] += clock_() - start;
}

void FramePath::run_solve(bool with_second_pass) {
  state_.uncertainty.is_stated = with_second_pass && forces_.has_error_model();
  if (!forces_.is_measured()) return;
  timed(StageId::kOperator,
        [&] { forces_.estimate(state_.displacement.node, is_light_steady_, state_.solve, state_.saturations); });
  if (!with_second_pass || !forces_.has_second_pass()) return;
  timed(StageId::kSupport, [&] { forces_.refine(is_light_steady_, state_.solve, state_.saturations); });
  state_.solve.is_refined = has(StageId::kSupport);
  if (!state_.solve.is_explained) state_.flags |= kFlagFeatures;
}

void FramePath::find_residual() {
  auto& residual = state_.residual;
  residual.validity = Validity::kNotMeasured;
  if (!state_.solve.is_refined) return;
  const uint64_t start = clock_();
  SaturationCounter saturations;  // its own: the forces are none the worse
  forces_.leave(state_.solve, residual.node, saturations);
  residual.validity = is_wrong() || saturations.count != 0 ? Validity::kInvalid : Validity::kValid;
  state_.stage_ns[static_cast<size_t>(StageId::kSupport)] += clock_() - start;
}

// A frame that is not to be believed is not remembered. Its time counts as the second pass's.
void FramePath::run_memory(uint64_t capture_us) {
  if (!forces_.has_memory() || !depth_is_trusted() || capture_us == 0 || is_wrong()) return;
  const uint64_t start = clock_();
  forces_.remember(capture_us, state_.solve, state_.saturations);
  state_.stage_ns[static_cast<size_t>(StageId::kSupport)] += clock_() - start;
}

void FramePath::solve(std::span<const NodeDisplacement> displacement) {
  state_.flags = 0;
  std::copy(displacement.begin(), displacement.end(), state_.displacement.node.begin());
  forces_.repair(state_.displacement.node, state_.displacement.is_filled);
  run_solve(true);
  Frame given = frame_of({}, 0);
  pipeline_.run_from(Slot::kNodeForces, given);
  run_uncertainty();
}

void FramePath::zero(int n_frames, bool is_watched) {
  if (rest_.is_ready()) rest_watch_.flags_before = state_.flags;
  rest_.restart(n_frames);
  picture_watch_.begin_rest();
  rest_watch_.is_watched = is_watched;
  rest_watch_.is_asked = rest_watch_.is_seen = true;
  forget();
}

void FramePath::expect_rest(std::span<const uint16_t> known) {
  if (rest_.is_ready()) return;  // the calibration's
  rest_watch_.is_expected = rest_watch_.is_seen = true;
  if (known.empty()) return;
  set_rest(known);
  rest_.restart(0);
}

// What was done to the pad before.
void FramePath::forget() {
  forces_.forget();
  pipeline_.forget();
}

void FramePath::set_rest(std::span<const uint16_t> image) {
  rest_.load(image);
  forget();
  warmth_.rest_mc = warmth_.now_mc;
  learn_features();
}

void FramePath::take_rest(const FramePath& other) {
  rest_watch_ = other.rest_watch_;
  if (!other.has_rest()) {
    if (other.rest_watch_.is_expected)
      expect_rest(other.is_zeroing() ? other.rest_image() : std::span<const uint16_t>());
    return;
  }
  set_rest(other.rest_image());
  warmth_.rest_mc = other.warmth_.rest_mc;
  picture_watch_ = other.picture_watch_;
}

FramePath::FramePath(const BoardSettings& board, std::shared_ptr<const CalibrationFile> calibration,
                     ClockFunction clock)
    : board_(board),
      calibration_(std::move(calibration)),
      clock_(clock),
      nodes_(board),
      rest_(board.camera.width_px, board.camera.height_px, board.n_rest_frames),
      picture_watch_(board.camera.width_px, board.camera.height_px),
      zero_follower_(static_cast<size_t>(nodes_.size().count())),
      light_(board.camera.width_px, board.camera.height_px),
      printed_(board),
      targets_(board),
      poisson_(board),
      displacement_(board),
      forces_(board, nodes_),
      state_(first_state(board)),
      pipeline_(board, state_, clock) {
  for (const std::string& stage : board.stages) {
    const auto at = std::find(known_stages().begin(), known_stages().end(), stage) - known_stages().begin();
    is_on_[static_cast<size_t>(at)] = true;
  }
  if (has_targets()) target_marks_.resize(targets().size());
  if (has(StageId::kMarkers) && board.markers.polarity == Polarity::kTexture) flow_.emplace(board);
  const auto n_pixels = static_cast<size_t>(board.camera.width_px * board.camera.height_px);
  const auto n_nodes = static_cast<size_t>(nodes_.size().count());
  state_.difference.change.resize(n_pixels * 3);
  state_.difference.grey.resize(n_pixels);
  state_.photometric.slope.resize(state_.depth.cell.size());
  state_.displacement.node.resize(n_nodes);
  state_.displacement.is_filled.resize(n_nodes);
  forces_.prepare(state_.solve);
  state_.uncertainty.node.resize(n_nodes);
  state_.residual.node.resize(3 * n_nodes);
  state_.markers.view.resize(printed_.n_views());
  state_.markers.marker = markers();
  if (has(StageId::kTargets)) state_.targets.target = targets();
}

}  // namespace ruffini
