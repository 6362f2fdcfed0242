// What the results of a frame are worth: its flags, and the validity of each quantity.
#include <algorithm>

#include "frame_path.h"
#include "image/marker_hole.h"
#include "image/slipped_rows.h"

namespace ruffini {
namespace {

constexpr int kMinMarkersPercent = 50;  // fewer at rest: this is not the board's pad

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
  return s.wrench.is_beyond_noise;
}

bool FramePath::light_is_trusted() const {
  return photometric_ && has(StageId::kPoisson) && !is_foreign_optics_ && has_gauge();
}

bool FramePath::is_wrong() const { return (state_.flags & kWrongFlags) != 0; }

// A view of several that has lost too many, or that never saw them, counts as blind; the others see.
bool FramePath::are_markers_lost() {
  if (!board_.markers.has_views) {
    const GridSize size = board_.markers.lattice;
    const int count = size.count(), n_missing = count - state_.markers.n_at_rest;
    const bool is_lattice = !board_.markers.is_scattered;
    const RowsOf rows_of = flow_ ? RowsOf::kPatches : RowsOf::kDots;
    if (is_lattice && has_slipped_rows(markers(), size, rows_of)) state_.flags |= kFlagPicture;
    if (is_lattice && !flow_ && has_hole(markers(), size, board_.camera.width_px, board_.camera.height_px)) return true;
    return state_.markers.n_lost > board_.markers.max_lost || 100 * n_missing > (100 - kMinMarkersPercent) * count;
  }
  size_t n_blind = 0;
  for (size_t view = 0; view < printed_.n_views(); ++view) {
    if (state_.markers.is_blind(view, board_.markers.max_lost)) ++n_blind;
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
  if (!forces_.is_measured()) s.flags |= kFlagUncalibratedXy | kFlagUncalibratedZ;
  const bool has_light = photometric_ && !is_foreign_optics_ && has_gauge();
  if (!marker_depth_ && !has_light) s.flags |= kFlagUncalibratedZ;
  const bool has_depth = photometric_ && has(StageId::kPoisson);
  s.depth.validity = validity_of(s.flags, has_depth, !is_foreign_optics_);
  s.force.xy = validity_of(s.flags, forces_.is_measured());
  s.force.z = validity_of(s.flags, forces_.is_measured() && depth_is_trusted());
  s.uncertainty.validity = validity_of(s.flags, s.uncertainty.is_stated);
  s.wrench.validity.fill(Validity::kNotMeasured);
  if (s.uncertainty.is_stated) s.covariance.is_stated = true;
  s.covariance.validity = s.uncertainty.validity;
  pipeline_.judge(s.flags);
}

}  // namespace ruffini
