// Displacement of the nodes from markers and depth (image/displacement.h). Includes the unknown constant of depth
// (estimators/depth_gauge.h) and depth from markers (estimators/marker_depth.h); then the creep of an untouched pad
// (estimators/zero_follower.h).
#include <algorithm>
#include <optional>

#include "core/stages.h"
#include "estimators/depth_gauge.h"
#include "estimators/marker_depth.h"
#include "estimators/wrench.h"
#include "estimators/zero_follower.h"
#include "image/camera_map.h"
#include "image/displacement.h"

namespace ruffini {
namespace {

class DisplacementStage final : public Stage {
 public:
  explicit DisplacementStage(const StageContext& c)
      : board_(c.board),
        displacement_(c.board),
        limit_q3_(c.board.pad.thickness_um * 8 / 2),
        markers_(c.slots.read<Slot::kMarkers>()),
        depth_(c.slots.amend<Slot::kDepth>()),
        out_(c.slots.write<Slot::kDisplacement>()) {}

  Status load(const Calibration& calibration) override {
    if (calibration.has_kind("camera")) {
      if (Status map = keep(CameraMap::load(calibration, board_), camera_map_); !map) return map;
      displacement_ = Displacement(camera_map_->ideal_board(), &*camera_map_);
    }
    if (board_.depth.has_gauge_table() && calibration.has_kind("gauge")) {
      if (Status gauge = keep(DepthGauge::load(calibration, board_), gauge_); !gauge) return gauge;
    }
    if (board_.depth.source == DepthSource::kMarkers && calibration.has_kind("marker_depth")) {
      if (Status depth = keep(MarkerDepth::load(calibration, board_), marker_depth_); !depth) return depth;
    }
    out_.has_depth = depth_.is_trusted || marker_depth_;
    return Unit{};
  }

  void learn(std::span<const uint16_t> /*rest*/) override { displacement_.learn(markers_.marker); }

  void run(Frame& frame) override {
    // Depth from tables for other optics is for display only, not for forces.
    const bool is_trusted = depth_.is_trusted;
    displacement_.run(markers_.marker,
                      is_trusted ? std::span<const DisplacementUm>(depth_.cell) : std::span<const DisplacementUm>(),
                      out_.node, frame.saturations);
    if (gauge_ && is_trusted) gauge_->run(out_.node, depth_.cell, frame.saturations);
    if (marker_depth_) marker_depth_->run(out_.node, frame.saturations);
    displacement_.mark_filled(markers_.marker, out_.filled);
    if (std::any_of(out_.node.begin(), out_.node.end(), [&](const NodeDisplacement& u) { return is_over_range(u); })) {
      frame.flags |= kFlagOverRange;
    }
  }

 private:
  [[nodiscard]] bool is_over_range(const NodeDisplacement& u) const {
    return std::max({u.x.raw(), u.y.raw(), u.z.raw()}) > limit_q3_ ||
           std::min({u.x.raw(), u.y.raw(), u.z.raw()}) < -limit_q3_;
  }

  BoardSettings board_;
  Displacement displacement_;
  int64_t limit_q3_;
  std::optional<CameraMap> camera_map_;
  std::optional<DepthGauge> gauge_;          // for boards whose gauge is a table
  std::optional<MarkerDepth> marker_depth_;  // for boards whose depth comes from the markers
  const SlotData<Slot::kMarkers>& markers_;
  SlotData<Slot::kDepth>& depth_;
  SlotData<Slot::kDisplacement>& out_;
};

// Part of the stage displacement; depends on what the previous frame's forces say.
class ZeroStage final : public Stage {
 public:
  explicit ZeroStage(const StageContext& c)
      : zero_(static_cast<size_t>(NodeGrid(c.board).size().count())),
        contacts_(c.slots.read<Slot::kContacts>()),
        wrench_(c.slots.read<Slot::kWrench>()),
        tip_(c.slots.read<Slot::kToolTouch>()),
        displacement_(c.slots.amend<Slot::kDisplacement>()) {}

  void learn(std::span<const uint16_t> /*rest*/) override {
    zero_.forget();
    publish();
  }

  void run(Frame& frame) override {
    if (frame.is_zero_followed) {
      const bool was_touched = shows_touch(contacts_, wrench_, tip_);
      zero_.run(displacement_.node, frame.is_wrong() || was_touched, frame.capture_us);
    }
    publish();
  }

 private:
  void publish() {
    displacement_.zero_moved_nm = zero_.moved_nm();
    displacement_.is_zero_at_limit = zero_.is_at_limit();
  }

  ZeroFollower zero_;
  const SlotData<Slot::kContacts>& contacts_;  // these three of the previous frame
  const SlotData<Slot::kWrench>& wrench_;
  const SlotData<Slot::kToolTouch>& tip_;
  SlotData<Slot::kDisplacement>& displacement_;
};

}  // namespace

StagePointer make_zero(const StageContext& context) { return std::make_unique<ZeroStage>(context); }
StagePointer make_displacement(const StageContext& context) { return std::make_unique<DisplacementStage>(context); }

}  // namespace ruffini
