#include "frame_path.h"

#include <algorithm>
#include <string>
#include <utility>

namespace ruffini {
namespace {

// Flags that a strong press can cause. If one appears while rest is learned, something has touched the pad.
constexpr uint32_t kByPress = kFlagMarkersLost | kFlagSaturated | kFlagOverRange | kFlagFeatures | kFlagLight;

// The depth grid is that of [depth], unless a stage defines its own. Results at the nodes are sent for all nodes, even
// if a board measures only some.
FrameState first_state(const BoardSettings& board) {
  FrameState state;
  state.depth.step_px = board.depth.step_px;
  state.depth.grid = {board.camera.width_px / board.depth.step_px, board.camera.height_px / board.depth.step_px};
  state.depth.cell.resize(static_cast<size_t>(state.depth.grid.count()));
  const auto n_nodes = static_cast<size_t>(NodeGrid(board).size().count());
  state.displacement.node.resize(n_nodes);
  state.displacement.filled.resize(n_nodes);
  state.solve.u.resize(3 * n_nodes);
  state.solve.force.resize(n_nodes);
  state.uncertainty.node.resize(n_nodes);
  state.residual.node.resize(3 * n_nodes);
  return state;
}

}  // namespace

const FrameState& FramePath::process(const FrameView& frame, uint64_t capture_us) {
  Frame now = begin(frame, capture_us);
  for (size_t segment = 0; segment < n_segments(); ++segment) {
    enter(segment, now);
    run(segment, now);
  }
  return state_;
}

// Measures relative to the rest image in force, even while another one is learned: kFlagNoReference marks the result
// invalid then.
Frame FramePath::begin(const FrameView& view, uint64_t capture_us) {
  const bool is_ready = rest_.is_ready();
  return {.view = view,
          .capture_us = capture_us,
          .warmth = warmth_,
          .flags = capture_flags_ | (is_ready ? 0U : uint32_t{kFlagNoReference}),
          .is_measured = is_ready || rest_.is_relearning(),
          .is_alone = !is_ready,
          .is_zero_followed = is_live_ && writes(Slot::kNodeForces)};
}

void FramePath::run(size_t segment, Frame& frame) {
  const bool is_timed = n_segments() > 1;
  const uint64_t start = is_timed ? clock_() : 0;
  if (frame.is_measured) {
    if (segment == 0) watch(frame);
    pipeline_.run(segment, frame);
  }
  if (segment + 1 == n_segments()) end(frame);
  if (is_timed) frame.segment_ns[segment] = clock_() - start;
}

void FramePath::end(Frame& frame) {
  if (rest_watch_.is_unverified) frame.flags |= kFlagRestUnverified;
  state_.stage_ns.fill(0);
  take_results(frame);
  rest_.is_ready() ? verify_rest() : learn_watched(frame.view);
  if (frame.saturations.count != 0) state_.flags |= kFlagSaturated;
  judge();
}

void FramePath::take_results(const Frame& frame) {
  state_.flags = frame.flags;
  state_.saturations.count += frame.saturations.count;
  for (size_t i = 0; i < kMaxRows; ++i) state_.stage_ns[i] += frame.stage_ns[i];
}

// Sets the flags of a picture that does not show the pad as it is now. Its time counts for the difference stage.
void FramePath::watch(Frame& frame) {
  if (!is_live_) return;
  const uint64_t start = clock_();
  const FrameWatch::Defects seen = picture_watch_.frame.run(frame.view);
  if (picture_watch_.repeated.run(frame.view)) frame.flags |= kFlagRepeated;
  const PixelStatistics::Defects pixels = picture_watch_.pixels.run(frame.view, pipeline_.first_state().light.gain);
  const bool has_blocks = picture_watch_.blocks.run(frame.view);
  if (seen.is_broken || pixels.is_coarse || has_blocks) frame.flags |= kFlagPicture;
  // Colours become slopes, and a level decides the area of a target.
  const bool needs_curve = writes(Slot::kSlope) || writes(Slot::kTargets);
  if (needs_curve && pixels.is_off_curve) frame.flags |= kFlagLight;
  // On fingertips no stage compares levels, and an offset moves the pins' centroids (image/frame_watch.h).
  if (seen.is_light_wrong || (seen.is_level_off && writes(Slot::kToolTouch))) frame.flags |= kFlagLight;
  pipeline_.charge(Slot::kDifference, clock_() - start, frame);
}

// Sets the validity of everything in this frame. Calibrated stages add their own.
void FramePath::judge() {
  state_.flags |= kFlagUncalibratedXy | kFlagUncalibratedZ;
  pipeline_.judge(state_.flags);
}

// Contacts of an invalid picture are ignored; an over-range contact still counts as pressed.
bool FramePath::is_touched() const { return presses(state_.flags); }

bool FramePath::is_touched_by_results() const { return shows_touch(state_.contacts, state_.wrench, state_.tip); }

// A surface that moved without an explaining force is assumed to be pressed.
bool FramePath::presses(uint32_t flags) const {
  const bool is_explained = state_.solve.is_explained;
  const uint32_t may_press = kFlagOverRange | kFlagSaturated | (is_explained ? 0U : kFlagFeatures);
  if ((flags & kWrongFlags & ~may_press) != 0) return false;
  return !is_explained || is_touched_by_results();
}

// The frame was measured with the previous rest image if there is one.
void FramePath::learn_watched(const FrameView& frame) {
  const uint32_t seen_flags = state_.flags & ~kFlagNoReference;
  const bool has_changed = rest_watch_.is_requested && (seen_flags & ~rest_watch_.flags_before & kByPress) != 0;
  if (rest_.is_relearning() && rest_watch_.is_watched && (has_changed || presses(seen_flags))) {
    rest_.cancel_learning();
    if (!rest_watch_.is_requested) rest_watch_.is_unverified = rest_watch_.is_from_last_run = true;
    ++rest_watch_.n_refused;
    pipeline_.forget();
    return;
  }
  const bool can_feel = writes(Slot::kNodeForces) || writes(Slot::kWrench);
  rest_watch_.is_comparable =
      rest_watch_.is_comparable && can_feel && rest_.is_relearning() && (seen_flags & kWrongFlags) == 0;
  learn(frame);
  if (!rest_.is_ready()) return;
  const bool is_known = rest_watch_.is_requested || rest_watch_.is_comparable;
  rest_watch_.is_unverified = rest_watch_.is_start_checked && !is_known;
  rest_watch_.is_from_last_run = false;
  if (is_known) ++rest_watch_.n_accepted;
}

// A start may have been refused because of a load, or because pad or camera were exchanged since the last run. A pad
// that appears untouched relative to the previous rest image excludes the latter.
void FramePath::verify_rest() {
  RestWatch& watch = rest_watch_;
  if (!watch.is_unverified || !watch.is_from_last_run) return;
  const bool is_untouched = (state_.flags & kWrongFlags) == 0 && !presses(state_.flags);
  watch.n_untouched = is_untouched ? watch.n_untouched + 1 : 0;
  if (watch.n_untouched >= board_.n_rest_frames) watch.is_unverified = false;
}

void FramePath::learn(const FrameView& frame) {
  if (is_live_) {
    if (!rest_.is_relearning()) picture_watch_.repeated.run(frame);  // otherwise watch() did
    picture_watch_.add_rest(frame);
  }
  if (!rest_.add(frame)) return;
  warmth_.rest_mc = warmth_.now_mc;
  learn_features();
}

void FramePath::learn_features() {
  picture_watch_.learn(rest_.image());
  pipeline_.learn(rest_.image());
}

void FramePath::compute_residual() {
  Frame last{.flags = state_.flags};
  pipeline_.compute(Slot::kResidual, last);
  take_results(last);
}

void FramePath::solve(std::span<const NodeDisplacement> displacement) {
  Frame given{.is_measured = false, .is_displacement_given = true};
  for (size_t segment = 0; segment < n_segments(); ++segment) enter(segment, given);
  std::copy(displacement.begin(), displacement.end(), state_.displacement.node.begin());
  repair_.run(state_.displacement.node, state_.displacement.filled);
  pipeline_.run_from(Slot::kDisplacement, given);
  take_results(given);
}

void FramePath::zero(int n_frames, bool is_watched) {
  if (rest_.is_ready()) rest_watch_.flags_before = state_.flags;
  rest_.restart(n_frames);
  picture_watch_.begin_rest();
  rest_watch_.is_watched = is_watched;
  rest_watch_.is_requested = rest_watch_.is_comparable = true;
  pipeline_.forget();
}

void FramePath::expect_rest(std::span<const uint16_t> known) {
  if (rest_.is_ready()) return;  // rest image of the calibration
  rest_watch_.is_start_checked = rest_watch_.is_comparable = true;
  if (known.empty()) return;
  set_rest(known);
  rest_.restart(0);
}

void FramePath::set_rest(std::span<const uint16_t> image) {
  rest_.load(image);
  pipeline_.forget();
  warmth_.rest_mc = warmth_.now_mc;
  learn_features();
}

void FramePath::take_rest(const FramePath& other) {
  rest_watch_ = other.rest_watch_;
  if (!other.has_rest()) {
    if (other.rest_watch_.is_start_checked)
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
      repair_(board, nodes_.size()),
      state_(first_state(board)),
      pipeline_(board, rest_, state_, clock) {}

// Loads the tables that the calibration has, and checks that they fit this board.
Status FramePath::load_tables() {
  if (!calibration_) return pipeline_.load(nullptr);
  const Calibration& c = calibration_->get();
  if (std::ssize(calibration_->bytes()) > board_.calibration_kb * 1024) {
    return Error{ErrorKind::kBadInput, "calibration file: larger than the " + std::to_string(board_.calibration_kb) +
                                           " kB of [memory] calibration_kb: make one with fewer nodes"};
  }
  const auto picture = [&](const char* name) {
    return c.tensor(name, Tensor::Type::kU16, {board_.camera.height_px, board_.camera.width_px, 3});
  };
  if (c.has_kind("dark")) {
    const auto dark = picture("dark.image");
    if (!dark) return dark.error();
    rest_.set_dark(dark.value()->as<uint16_t>());
  }
  if (Status stages = pipeline_.load(&c); !stages) return stages;
  if (c.has_kind("rest")) {
    const auto rest = picture("rest.image");
    if (!rest) return rest.error();
    set_rest(rest.value()->as<uint16_t>());
  }
  return Unit{};
}

Result<std::unique_ptr<FramePath>> FramePath::configure(const BoardSettings& board,
                                                        std::shared_ptr<const CalibrationFile> calibration,
                                                        ClockFunction clock) {
  std::unique_ptr<FramePath> path(new FramePath(board, std::move(calibration), clock));
  Status loaded = path->load_tables();
  if (!loaded) return loaded.error();
  return path;
}

}  // namespace ruffini
