// Depth from slopes (image/poisson.h), in the view of the camera map's ideal pinhole if there is one; and the validity
// of depth from light. Takes depth as it is if colours were converted to it directly.
#include <algorithm>

#include "core/stages.h"
#include "image/camera_map.h"
#include "image/poisson.h"

namespace ruffini {
namespace {

class PoissonStage final : public Stage {
 public:
  explicit PoissonStage(const StageContext& c)
      : board_(c.board),
        poisson_(c.board),
        slope_(c.slots.read<Slot::kSlope>()),
        depth_(c.slots.write<Slot::kDepth>()) {}

  Status load(const Calibration& calibration) override {
    depth_.is_trusted = !slope_.is_foreign_optics && (!board_.depth.has_gauge_table() || calibration.has_kind("gauge"));
    if (!calibration.has_kind("camera")) return Unit{};
    const auto ideal = pinhole_board(calibration, board_);
    if (!ideal) return ideal.error();
    poisson_ = Poisson(ideal.value());
    return Unit{};
  }

  void run(Frame& frame) override {
    if (slope_.is_of_depth) {
      std::copy(slope_.depth.begin(), slope_.depth.end(), depth_.cell.begin());
      return;
    }
    poisson_.run(slope_.slope, depth_.cell, depth_.is_trusted ? frame.saturations : untrusted_saturations_);
  }

 private:
  BoardSettings board_;
  Poisson poisson_;
  SaturationCounter untrusted_saturations_;  // of depth that is not used for forces
  const SlotData<Slot::kSlope>& slope_;
  SlotData<Slot::kDepth>& depth_;
};

// Part of the stage poisson at the end of the frame, when all flags are known.
class DepthValidityStage final : public Stage {
 public:
  explicit DepthValidityStage(const StageContext& c)
      : slope_(c.slots.read<Slot::kSlope>()), depth_(c.slots.amend<Slot::kDepth>()) {}

  void run(Frame& /*frame*/) override {}
  void judge(uint32_t& flags) override { depth_.validity = validity_of(flags, true, !slope_.is_foreign_optics); }

 private:
  const SlotData<Slot::kSlope>& slope_;
  SlotData<Slot::kDepth>& depth_;
};

}  // namespace

StagePointer make_depth_validity(const StageContext& context) { return std::make_unique<DepthValidityStage>(context); }
StagePointer make_poisson(const StageContext& context) { return std::make_unique<PoissonStage>(context); }

}  // namespace ruffini
