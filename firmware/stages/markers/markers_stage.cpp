// Markers and how far they have moved from rest: printed ones (image/printed_markers.h), or patches of a texture
// (image/texture_flow.h); and whether this is the board's pad.
#include <optional>

#include "core/stages.h"
#include "image/marker_hole.h"
#include "image/pitch_check.h"
#include "image/printed_markers.h"
#include "image/slipped_pins.h"
#include "image/slipped_rows.h"
#include "image/texture_flow.h"

namespace ruffini {
namespace {

constexpr int kMinMarkersPercent = 50;  // fewer at rest: this is not the board's pad

class MarkersStage final : public Stage {
 public:
  explicit MarkersStage(const StageContext& c)
      : board_(c.board),
        slipped_pins_(c.board.camera.height_px),
        difference_(c.slots.read<Slot::kDifference>()),
        markers_(c.slots.write<Slot::kMarkers>()),
        features_(c.slots.write<Slot::kFeatures>()) {
    if (board_.markers.polarity == Polarity::kTexture) {
      flow_.emplace(board_);
    } else {
      printed_.emplace(board_);
      markers_.view.resize(printed_->n_views());
    }
    publish();
  }

  // A picture through any lens is not of the board's pitch.
  Status load(const Calibration& calibration) override {
    has_camera_map_ = calibration.has_kind("camera");
    return Unit{};
  }

  void learn(std::span<const uint16_t> rest) override {
    if (flow_) {
      markers_.n_at_rest = flow_->learn(difference_.grey, rest);
    } else {
      markers_.n_at_rest = printed_->learn(difference_.grey, rest);
      // Of twice as many dots, every second one would do.
      is_other_pad_ = (!has_camera_map_ && !pitch_fits(printed_->markers(), board_)) ||
                      printed_->n_dots_at_rest() > 2 * board_.markers.lattice.count();
      if (board_.markers.has_views) slipped_pins_.learn(printed_->markers(), printed_->n_views());
      for (size_t i = 0; i < markers_.view.size(); ++i) {
        markers_.view[i].was_seen_at_rest = printed_->was_seen_at_rest(i);
      }
    }
    publish();
  }

  void run(Frame& frame) override {
    const std::span<const uint16_t> grey = difference_.grey;
    markers_.n_lost = flow_ ? flow_->track(grey, frame.view) : printed_->track(grey, frame.view);
    publish();
    if (is_other_pad_) frame.flags |= kFlagOtherPad;
    if (board_.markers.has_views ? are_views_lost(frame.flags) : are_lost(frame.flags)) frame.flags |= kFlagMarkersLost;
  }

 private:
  void publish() {
    const std::span<const Marker> seen = flow_ ? flow_->markers() : printed_->markers();
    markers_.marker.assign(seen.begin(), seen.end());
    features_.value.resize(2 * markers_.marker.size());
    auto shift = features_.value.begin();
    for (const Marker& m : markers_.marker) {
      *shift++ = m.displacement_x.raw();
      *shift++ = m.displacement_y.raw();
    }
    if (!board_.markers.has_views) return;
    for (size_t i = 0; i < markers_.view.size(); ++i) markers_.view[i].n_low_confidence = printed_->n_low_confidence(i);
  }

  [[nodiscard]] bool are_lost(uint32_t& flags) const {
    const GridSize size = board_.markers.lattice;
    const int count = size.count(), n_missing = count - markers_.n_at_rest;
    const bool is_lattice = !board_.markers.is_scattered;
    const RowsOf rows_of = flow_ ? RowsOf::kPatches : RowsOf::kDots;
    if (is_lattice && has_slipped_rows(markers_.marker, size, rows_of)) flags |= kFlagPicture;
    if (is_lattice && !flow_ &&
        has_hole(markers_.marker, board_.markers, board_.camera.width_px, board_.camera.height_px)) {
      return true;
    }
    return markers_.n_lost > board_.markers.max_lost || 100 * n_missing > (100 - kMinMarkersPercent) * count;
  }

  // A view of several that has lost too many, or that never saw them, counts as blind; the others see.
  [[nodiscard]] bool are_views_lost(uint32_t& flags) {
    if (slipped_pins_.run(markers_.marker)) flags |= kFlagPicture;
    size_t n_blind = 0;
    for (size_t view = 0; view < markers_.view.size(); ++view) {
      if (markers_.is_blind(view, board_.markers.max_lost)) ++n_blind;
    }
    if (n_blind > 0) flags |= kFlagViewLost;
    return n_blind == markers_.view.size();
  }

  BoardSettings board_;
  std::optional<PrintedMarkers> printed_;
  std::optional<TextureFlow> flow_;
  SlippedPins slipped_pins_;  // of views
  bool has_camera_map_ = false;
  bool is_other_pad_ = false;
  const SlotData<Slot::kDifference>& difference_;
  SlotData<Slot::kMarkers>& markers_;
  SlotData<Slot::kFeatures>& features_;
};

}  // namespace

StagePointer make_markers(const StageContext& context) { return std::make_unique<MarkersStage>(context); }

}  // namespace ruffini
