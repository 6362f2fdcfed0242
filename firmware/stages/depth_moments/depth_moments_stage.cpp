// Moments of the dent (stages/depth_moments/depth_moments.h), as features of a wrench. Depth of other optics is for
// display, so that no features are made of it.
#include "core/stages.h"
#include "image/camera_map.h"
#include "stages/depth_moments/depth_moments.h"

namespace ruffini {
namespace {

class DepthMomentsStage final : public Stage {
 public:
  explicit DepthMomentsStage(const StageContext& c)
      : board_(c.board),
        moments_(c.board),
        depth_(c.slots.read<Slot::kDepth>()),
        features_(c.slots.write<Slot::kFeatures>()) {
    features_.value.resize(DepthMoments::kCount);
  }

  // Depth is in the view of the camera map's ideal pinhole.
  Status load(const Calibration& calibration) override {
    const auto ideal = pinhole_board(calibration, board_);
    if (!ideal) return ideal.error();
    moments_ = DepthMoments(ideal.value());
    return Unit{};
  }

  [[nodiscard]] bool writes(Slot /*slot*/) const override { return depth_.is_trusted; }

  void run(Frame& /*frame*/) override {
    moments_.run(depth_.cell, std::span<int32_t, DepthMoments::kCount>(features_.value));
  }

 private:
  BoardSettings board_;
  DepthMoments moments_;
  const SlotData<Slot::kDepth>& depth_;
  SlotData<Slot::kFeatures>& features_;
};

}  // namespace

StagePointer make_depth_moments(const StageContext& context) { return std::make_unique<DepthMomentsStage>(context); }

}  // namespace ruffini
