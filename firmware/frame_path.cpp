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

constexpr size_t kForceZAlone = 11;  // of the covariance's upper triangle by rows: (2, 2)
constexpr int kMostUnsureAlone = 1;  // pins of an eye that sees alone, e.g. one at the edge of its view

// Where some pins are known to be seen wrong there may be more; an eye alone has less to contradict it.
bool are_pins_doubtful(const PrintedMarkers& printed, int n_contradicted, int64_t most, Eyes eyes) {
  if (eyes == Eyes::kBoth) return printed.n_unsure(0) + printed.n_unsure(1) + n_contradicted > most;
  return printed.n_unsure(eyes == Eyes::kLeft ? 0 : 1) > kMostUnsureAlone || n_contradicted > most;
}

}  // namespace

// The life of a frame. Stage by stage: firmware/README.md.
const FrameState& FramePath::process(const FrameView& frame, uint64_t capture_us) {
  state_.flags = capture_flags_;
  state_.stage_ns.fill(0);
  state_.uncertainty.is_stated = state_.uncertainty.is_of_wrench = false;
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
  run_estimators();
  run_uncertainty();
  timed(StageId::kSkin, [&] { run_skin(frame, capture_us); });
  run_feature_wrench(capture_us);
  timed(StageId::kContactModel, [&] { run_contact_model(capture_us); });
  run_fingertip();
  timed(StageId::kHelmholtz, [&] { run_helmholtz(); });
  timed(StageId::kContactDepth, [&] { run_contact_depth(); });
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
  const bool can_feel = forces_.is_measured() || feature_wrench_ || skin_ || fingertip_;
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
  if (skin_) skin_->learn(rest_.image());
  if (!has(StageId::kMarkers) && !has(StageId::kTargets)) return;
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
    n_markers_at_rest_ = flow_->learn(grey, rest);
  } else {
    n_markers_at_rest_ = printed_.learn(grey, rest);
    // Of twice as many dots, every second one would do.
    is_other_pad_ = (!camera_map_ && !pitch_fits(markers(), board_)) ||
                    printed_.n_dots_at_rest() > 2 * board_.markers.lattice.count();
  }
  if (!board_.markers.has_views) displacement_.learn(markers());
  if (corner_motion_) corner_motion_->learn(markers(), *feature_wrench_);
  if (!fingertip_) return;
  fingertip_->learn(markers());
  const auto eyes = seeing([&](size_t eye) { return printed_.was_seen_at_rest(eye); });
  is_other_pad_ = is_other_pad_ || (eyes && fingertip_->is_other_pad(*eyes));
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
          [&] { photometric_->run_depth(state_.difference.change, light_.level(), state_.poisson.depth); });
    return;
  }
  timed(StageId::kPhotometric, [&] {
    photometric_->run(state_.difference.change, hidden(), light_.level(), state_.photometric.slope);
    if (camera_map_) camera_map_->rectify(state_.photometric.slope);
  });
  SaturationCounter& saturations = light_is_trusted() ? state_.saturations : untrusted_saturations_;
  timed(StageId::kPoisson, [&] { poisson_.run(state_.photometric.slope, state_.poisson.depth, saturations); });
}

void FramePath::run_displacement() {
  // A table of other optics gives a depth to look at, not one to make forces of.
  const bool is_measured = light_is_trusted();
  displacement_.run(
      markers(),
      is_measured ? std::span<const DisplacementUm>(state_.poisson.depth) : std::span<const DisplacementUm>(),
      state_.displacement.node, state_.saturations);
  if (depth_gauge_ && is_measured) {
    depth_gauge_->run(state_.displacement.node, state_.poisson.depth, state_.saturations);
  }
  if (marker_depth_) marker_depth_->run(state_.displacement.node, state_.saturations);
  displacement_.mark_filled(markers(), state_.displacement.is_filled);
}

// Its time counts as the second pass's.
void FramePath::run_uncertainty() {
  if (!state_.uncertainty.is_stated) return;
  const uint64_t start = clock_();
  if (state_.solve.is_refined && forces_.has_camera_moved(state_.solve, state_.wrench)) state_.flags |= kFlagFeatures;
  const std::span<const uint8_t> is_filled = state_.displacement.is_filled;
  forces_.state_sigma(state_.solve, is_filled, state_.uncertainty.node);
  state_.uncertainty.wrench = forces_.state_covariance(state_.solve, is_filled, state_.wrench, state_.contacts);
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

void FramePath::run_estimators() {
  if (!forces_.is_measured()) return;
  timed(StageId::kWrench, [&] {
    state_.wrench = sum_wrench(nodes_, state_.solve.force, board_.force_lsb_un);
    if (!forces_.is_at_finite_strain()) return;
    move_arms(state_.solve.force, state_.displacement.node, board_.force_lsb_un, state_.wrench, state_.saturations);
  });
  timed(StageId::kContacts, [&] {
    state_.contacts = contacts_.find(state_.solve.mask, state_.solve.force, state_.displacement.node);
    slip_.track(state_.contacts, contacts_.component(), state_.solve.force, state_.displacement.node);
    state_.slip.contact = slip_.contacts();
  });
}

int FramePath::n_features() const {
  return static_cast<int>(has_targets() ? 3 * targets().size() : 2 * markers().size());
}

// Shifts in px Q16, changes of area in px^2 Q8.
void FramePath::run_feature_wrench(uint64_t capture_us) {
  if (!feature_wrench_) return;
  timed(StageId::kFeatureWrench, [&] {
    auto out = features_.begin();
    const auto put = [&](int64_t value) { *out++ = saturate_raw<int32_t>(value, state_.saturations); };
    if (has_targets()) {
      for (const Target& t : targets()) {
        put(t.now.x_q16 - t.rest.x_q16);
        put(t.now.y_q16 - t.rest.y_q16);
        put(t.now.area_q8 - t.rest.area_q8);
      }
    } else {
      for (const Marker& m : markers()) {
        put(m.displacement_x.raw());
        put(m.displacement_y.raw());
      }
    }
    // A frame that is not to be believed is not remembered.
    const bool is_wrong = this->is_wrong();
    const FeatureWrench::Outcome said =
        feature_wrench_->run(features_, warmth_, is_wrong ? 0 : capture_us, state_.saturations);
    state_.wrench = said.wrench;
    state_.uncertainty.wrench = said.covariance;
    state_.uncertainty.is_of_wrench = true;
    const bool has_moved = corner_motion_ && corner_motion_->has_moved(markers(), said.wrench);
    if (!said.is_in_agreement || has_moved) state_.flags |= kFlagFeatures;
    if (!said.is_in_range) state_.flags |= kFlagOverRange;
    if (!said.is_warmth_known) state_.flags |= kFlagTemperature;
  });
}

// The one contact that the flow of a texture is of.
void FramePath::run_contact_model(uint64_t capture_us) {
  FrameState& s = state_;
  s.profile = contact_profile_->run(markers());
  if (!contact_model_) return;
  s.contacts = {};
  s.modelled = contact_model_->run(s.profile, s.wrench, !is_wrong(), capture_us, s.saturations);
  const ModelledContact& c = s.modelled;
  if (c.is_covered) s.flags |= kFlagMarkersLost;
  if (c.is_over_range) s.flags |= kFlagOverRange;
  if (!c.is_touched) return;
  s.contacts.n_listed = s.contacts.n_found = 1;
  s.contacts.contacts[0] = {.area_um2 = c.area_um2,
                            .center_x_um = s.profile.center_x_um,
                            .center_y_um = s.profile.center_y_um,
                            .force_x_un = s.wrench.force_x_un,
                            .force_y_un = s.wrench.force_y_un,
                            .force_z_un = s.wrench.force_z_un,
                            .peak_depth_nm = -1'000 * c.gel_depth_um};
}

void FramePath::run_helmholtz() {
  state_.helmholtz = helmholtz_->run(contact_profile_->flow(), state_.profile, state_.saturations);
}

// Zero where nothing touches.
void FramePath::run_contact_depth() {
  if (!contact_depth_) return;
  FrameState& s = state_;
  if (s.modelled.is_touched) {
    contact_depth_->run(*contact_profile_, s.profile, contact_model_->inputs(), s.poisson.depth, s.saturations);
  } else {
    std::fill(s.poisson.depth.begin(), s.poisson.depth.end(), DisplacementUm{});
  }
}

// Touches are contacts of an unrolled skin, whose z is out of it everywhere.
void FramePath::run_skin(const FrameView& frame, uint64_t capture_us) {
  state_.skin = skin_->run(frame, capture_us, state_.saturations);
  if (state_.skin.is_dark) state_.flags |= kFlagDark;
  if (state_.skin.is_light_off) state_.flags |= kFlagLight;
  const SkinTouchList& touches = state_.skin.touches;
  state_.contacts = {.n_listed = touches.n_listed, .n_found = touches.n_found};
  state_.wrench = {};
  for (size_t i = 0; i < static_cast<size_t>(touches.n_listed); ++i) {
    const SkinTouch& t = touches.touch[i];
    state_.contacts.contacts[i] = {
        .area_um2 = t.area_um2, .center_x_um = t.x_um, .center_y_um = t.y_um, .force_z_un = -t.press_un};
    state_.wrench.force_z_un -= t.press_un;
  }
}

// By the eyes that see. Its touch is a contact on the undeformed dome, seen from above.
void FramePath::run_fingertip() {
  if (!fingertip_) return;
  timed(StageId::kFingertip, [&] {
    FrameState& s = state_;
    s.tip = {};
    s.contacts = {};
    s.wrench = {};
    s.uncertainty.wrench = {};
    const auto eyes = seeing([&](size_t eye) { return !is_blind(eye); });
    if (!eyes) return;
    s.tip = fingertip_->run(markers(), *eyes, s.saturations);
    const int n_contradicted = fingertip_->n_contradicted();
    if (are_pins_doubtful(printed_, n_contradicted, board_.markers.max_lost, *eyes)) s.flags |= kFlagMarkersLost;
    if (s.tip.has_camera_moved) s.flags |= kFlagFeatures;
    if (!s.tip.is_touched) return;
    if (!s.tip.is_known) s.flags |= kFlagFeatures;
    if (!s.tip.is_in_range) s.flags |= kFlagOverRange;
    const int64_t radius_um = board_.pad.size_x_um / 2;
    s.wrench.force_z_un = -(s.tip.force_un * s.tip.axis_1e6[2] / 1'000'000);
    const int64_t sigma_un = s.tip.sigma[0] * s.tip.axis_1e6[2] / 1'000'000;
    s.uncertainty.wrench.upper[kForceZAlone] = sigma_un * sigma_un;
    s.contacts = {.n_listed = 1, .n_found = 1};
    s.contacts.contacts[0] = {.area_um2 = s.tip.area_um2,
                              .center_x_um = round_shift(radius_um * s.tip.place_q14[0], 14),
                              .center_y_um = round_shift(radius_um * s.tip.place_q14[1], 14),
                              .force_z_un = s.wrench.force_z_un,
                              .peak_depth_nm = -1'000 * s.tip.way_um};
  });
}

void FramePath::solve(std::span<const NodeDisplacement> displacement) {
  state_.flags = 0;
  std::copy(displacement.begin(), displacement.end(), state_.displacement.node.begin());
  forces_.repair(state_.displacement.node, state_.displacement.is_filled);
  run_solve(true);
  run_estimators();
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
  slip_.forget();
  if (feature_wrench_) feature_wrench_->forget();
  if (contact_model_) contact_model_->forget();
  state_.modelled = {};
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
      depth_step_px_(ContactDepth::is_of(board) ? ContactDepth::step_px(board) : board.depth.step_px),
      depth_grid_{board.camera.width_px / depth_step_px_, board.camera.height_px / depth_step_px_},
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
      contacts_(nodes_, board.force_lsb_un, forces_.contact_threshold_lsb()),
      slip_(nodes_, board.force_lsb_un) {
  for (const std::string& stage : board.stages) {
    const auto at = std::find(known_stages().begin(), known_stages().end(), stage) - known_stages().begin();
    is_on_[static_cast<size_t>(at)] = true;
  }
  if (has_targets()) target_marks_.resize(targets().size());
  if (has(StageId::kMarkers) && board.markers.polarity == Polarity::kTexture) flow_.emplace(board);
  if (has(StageId::kContactModel)) contact_profile_.emplace(board);
  if (has(StageId::kHelmholtz)) helmholtz_.emplace(board);
  const auto n_pixels = static_cast<size_t>(board.camera.width_px * board.camera.height_px);
  const auto n_nodes = static_cast<size_t>(nodes_.size().count());
  state_.difference.change.resize(n_pixels * 3);
  state_.difference.grey.resize(n_pixels);
  state_.photometric.slope.resize(static_cast<size_t>(depth_grid_.count()));
  state_.poisson.depth.resize(static_cast<size_t>(depth_grid_.count()));
  state_.displacement.node.resize(n_nodes);
  state_.displacement.is_filled.resize(n_nodes);
  forces_.prepare(state_.solve);
  state_.uncertainty.node.resize(n_nodes);
  state_.residual.node.resize(3 * n_nodes);
  state_.slip.node = slip_.nodes();
}

}  // namespace ruffini
