// What the results of a frame are worth: its flags, and the validity of each quantity.
#include <algorithm>

#include "frame_path.h"
#include "image/marker_hole.h"
#include "image/slipped_rows.h"

namespace ruffini {
namespace {

constexpr int64_t kMaxForceUn = 2'000'000'000;  // its square fits
constexpr int kMinMarkersPercent = 50;          // fewer at rest: this is not the board's pad

}  // namespace

// What the frame shows to be no picture of the pad as it is now. Its time counts as the difference's.
void FramePath::watch(const FrameView& frame) {
  if (!is_live_) return;
  const uint64_t start = clock_();
  const FrameWatch::Verdict seen = picture_watch_.frame.run(frame);
  if (picture_watch_.old.run(frame)) state_.flags |= kFlagRepeated;
  const PixelStatistics::Verdict pixels = picture_watch_.pixels.run(frame, light_.gain());
  const bool has_blocks = picture_watch_.blocks.run(frame);
  if (seen.is_broken || pixels.is_coarse || has_blocks) state_.flags |= kFlagPicture;
  if (photometric_ && pixels.is_off_curve) state_.flags |= kFlagLight;  // where colours become numbers
  if (seen.is_lamp_off) state_.flags |= kFlagLight;
  state_.stage_ns[static_cast<size_t>(StageId::kDifference)] += clock_() - start;
}

// Nothing pressed by the frame before, and nothing is wrong with this one. Contacts are still those of the frame before.
void FramePath::follow_zero(uint64_t capture_us) {
  if (!is_live_ || !forces_.is_measured()) return;
  zero_follower_.run(state_.displacement.node, is_wrong() || is_touched(), capture_us);
}

// Contacts of a frame whose picture is wrong mean nothing; one that is out of range presses all the more.
bool FramePath::is_touched() const { return presses(state_.flags); }

// A surface that moved as no stated force moves it is pressed for all that is known.
bool FramePath::presses(uint32_t flags) const {
  const FrameState& s = state_;
  const uint32_t may_press = kFlagOverRange | kFlagSaturated | (s.solve.is_explained ? 0U : kFlagFeatures);
  if ((flags & kWrongFlags & ~may_press) != 0) return false;
  if (!s.solve.is_explained) return true;
  if (s.contacts.n_found > 0 || s.tip.is_touched) return true;
  if (!feature_wrench_) return false;
  // A wrench without contacts: beyond five standard deviations.
  const auto& variance = s.uncertainty.wrench.upper;
  const auto is_beyond = [](int64_t force_un, int64_t variance_un2) {
    const int64_t f = std::clamp<int64_t>(force_un, -kMaxForceUn, kMaxForceUn);
    return f * f / 25 > variance_un2;
  };
  return is_beyond(s.wrench.force_x_un, variance[0]) || is_beyond(s.wrench.force_y_un, variance[6]) ||
         is_beyond(s.wrench.force_z_un, variance[11]);
}

bool FramePath::light_is_trusted() const {
  return photometric_ && has(StageId::kPoisson) && !is_foreign_optics_ && has_gauge();
}

bool FramePath::is_wrong() const { return (state_.flags & kWrongFlags) != 0; }

bool FramePath::is_blind(size_t view) const {
  return !printed_.was_seen_at_rest(view) || printed_.n_unsure(view) > board_.markers.max_lost;
}

// A view of several that has lost too many, or that never saw them, counts as blind; the others see.
bool FramePath::are_markers_lost() {
  if (!board_.markers.has_views) {
    const GridSize size = board_.markers.lattice;
    const int count = size.count(), n_missing = count - n_markers_at_rest_;
    const bool is_lattice = !board_.markers.is_scattered;
    const RowsOf rows_of = flow_ ? RowsOf::kPatches : RowsOf::kDots;
    if (is_lattice && has_slipped_rows(markers(), size, rows_of)) state_.flags |= kFlagPicture;
    if (is_lattice && !flow_ && has_hole(markers(), size, board_.camera.width_px, board_.camera.height_px)) return true;
    return state_.markers.n_lost > board_.markers.max_lost || 100 * n_missing > (100 - kMinMarkersPercent) * count;
  }
  size_t n_blind = 0;
  for (size_t view = 0; view < printed_.n_views(); ++view) {
    if (is_blind(view)) ++n_blind;
  }
  if (n_blind > 0) state_.flags |= kFlagViewLost;
  return n_blind == printed_.n_views();
}

// Flags of what the frame shows, before anything is made of it.
void FramePath::judge_input() {
  FrameState& s = state_;
  const int n_pixels = board_.camera.width_px * board_.camera.height_px;
  // Of several views one may be dark.
  const int n_views = static_cast<int>(printed_.n_views());
  if (s.difference.exposure.dark * 2 > n_pixels * (2 * n_views - 1) / n_views) s.flags |= kFlagDark;
  if (s.difference.exposure.full * 20 > n_pixels) s.flags |= kFlagOverexposed;
  if (has(StageId::kMarkers) && are_markers_lost()) s.flags |= kFlagMarkersLost;
  if (is_other_pad_) s.flags |= kFlagOtherPad;
  if (s.targets.n_lost > 0) s.flags |= kFlagMarkersLost;
  const int64_t limit_q3 = board_.pad.thickness_um * 8 / 2;
  for (const NodeDisplacement& u : s.displacement.node) {
    if (std::max({u.x.raw(), u.y.raw(), u.z.raw()}) > limit_q3 ||
        std::min({u.x.raw(), u.y.raw(), u.z.raw()}) < -limit_q3) {
      s.flags |= kFlagOverRange;
      break;
    }
  }
}

// Validity of everything that this frame says.
void FramePath::judge() {
  FrameState& s = state_;
  if (!forces_.is_measured() && !feature_wrench_) s.flags |= kFlagUncalibratedXy | kFlagUncalibratedZ;
  const bool has_light = photometric_ && !is_foreign_optics_ && has_gauge();
  if (!feature_wrench_ && !marker_depth_ && !has_light) s.flags |= kFlagUncalibratedZ;
  const bool is_wrong = this->is_wrong();
  if (is_wrong) slip_.forget();
  const auto verdict = [&](bool is_measured, bool is_calibrated) {
    if (!is_measured) return Validity::kNotMeasured;
    if (is_wrong) return Validity::kInvalid;
    return is_calibrated ? Validity::kValid : Validity::kUncalibrated;
  };
  const bool has_depth = photometric_ && has(StageId::kPoisson);
  s.depth_validity = verdict(has_depth, !is_foreign_optics_);
  s.force_xy = verdict(forces_.is_measured(), true);
  s.force_z = verdict(forces_.is_measured() && depth_is_trusted(), true);
  s.uncertainty.validity = verdict(s.uncertainty.is_stated, true);
  s.wrench_validity = {s.force_xy, s.force_xy, s.force_z, s.force_z, s.force_z, s.force_xy};
  if (feature_wrench_) {
    for (size_t i = 0; i < s.wrench_validity.size(); ++i) {
      s.wrench_validity[i] = verdict(feature_wrench_->measures(i), (s.flags & kFlagTemperature) == 0);
    }
  } else {
    s.uncertainty.is_of_wrench = s.uncertainty.is_stated;
  }
  s.uncertainty.wrench_validity = verdict(s.uncertainty.is_of_wrench, true);
  if (skin_) judge_skin();
  if (contact_model_) judge_contact_model();
  if (fingertip_) judge_fingertip();
  if (s.force_z == Validity::kValid && s.contacts.reaches_border) s.flags |= kFlagWindowBorder;
}

// Forces of the contact are those of the wrench: there is no field of them.
void FramePath::judge_contact_model() {
  FrameState& s = state_;
  const ModelledContact& c = s.modelled;
  const auto verdict = [&](bool is_told) {
    if (!is_told) return Validity::kNotMeasured;
    return is_wrong() || c.is_strange ? Validity::kInvalid : Validity::kValid;
  };
  s.contact_depth = verdict(c.is_touched);
  if (contact_depth_) s.depth_validity = verdict(true);
  s.hardness = verdict(c.is_touched && c.has_hardness);
}

// The force along z is all of the wrench that a fingertip measures.
void FramePath::judge_fingertip() {
  FrameState& s = state_;
  s.flags &= ~(kFlagUncalibratedXy | kFlagUncalibratedZ);
  // What one eye does not feel may be there.
  const bool is_unseen = !s.tip.is_touched && (s.flags & kFlagViewLost) != 0;
  s.force_z = is_wrong() || is_unseen ? Validity::kInvalid : Validity::kValid;
  s.wrench_validity.fill(Validity::kNotMeasured);
  s.wrench_validity[2] = s.force_z;
  s.uncertainty.is_of_wrench = s.tip.is_touched;
  s.uncertainty.wrench_validity = s.tip.is_touched ? s.force_z : Validity::kNotMeasured;
}

// Pressing is all that a skin measures.
void FramePath::judge_skin() {
  FrameState& s = state_;
  if (skin_->is_calibrated()) s.flags &= ~(kFlagUncalibratedXy | kFlagUncalibratedZ);
  const bool is_wrong = this->is_wrong();
  s.force_xy = Validity::kNotMeasured;
  s.force_z = !skin_->is_calibrated() ? Validity::kNotMeasured : is_wrong ? Validity::kInvalid : Validity::kValid;
  s.wrench_validity.fill(Validity::kNotMeasured);
  s.wrench_validity[2] = s.force_z;
}

}  // namespace ruffini
