// The change of the picture over a grid on the gel (stages/picture_features/picture_features.h), as features of a
// wrench.
#include "core/stages.h"
#include "stages/picture_features/picture_features.h"

namespace ruffini {
namespace {

class PictureFeaturesStage final : public Stage {
 public:
  explicit PictureFeaturesStage(const StageContext& c)
      : grid_(c.board.picture_features, c.board.camera.width_px, c.board.camera.height_px),
        difference_(c.slots.read<Slot::kDifference>()),
        features_(c.slots.write<Slot::kFeatures>()) {
    features_.value.resize(grid_.count());
    features_.n_planes = PictureFeatures::kChannels;
    features_.cells = c.board.picture_features.cells;
  }

  void run(Frame& /*frame*/) override { grid_.run(difference_.change, features_.value); }

 private:
  PictureFeatures grid_;
  const SlotData<Slot::kDifference>& difference_;
  SlotData<Slot::kFeatures>& features_;
};

}  // namespace

StagePointer make_picture_features(const StageContext& context) {
  return std::make_unique<PictureFeaturesStage>(context);
}

}  // namespace ruffini
