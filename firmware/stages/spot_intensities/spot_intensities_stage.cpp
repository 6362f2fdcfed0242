// Light of spots (stages/spot_intensities/spot_intensities.h), as features of a wrench. More lost spots than [markers]
// max_lost make a frame invalid.
#include "core/stages.h"
#include "stages/spot_intensities/spot_intensities.h"

namespace ruffini {
namespace {

class SpotIntensitiesStage final : public Stage {
 public:
  explicit SpotIntensitiesStage(const StageContext& c)
      : max_lost_(c.board.markers.max_lost),
        spots_(c.board),
        difference_(c.slots.read<Slot::kDifference>()),
        features_(c.slots.write<Slot::kFeatures>()) {
    const MarkerSettings& markers = c.board.markers;
    features_.value.resize(markers.is_scattered ? markers.places.size() : static_cast<size_t>(markers.lattice.count()));
    if (markers.is_scattered) return;
    features_.n_planes = 1;
    features_.cells = markers.lattice;
  }

  // Without places there is nothing to measure.
  [[nodiscard]] bool writes(Slot /*slot*/) const override { return spots_.has_places(); }

  void learn(std::span<const uint16_t> rest) override { spots_.learn(difference_.grey, rest); }

  void run(Frame& frame) override {
    const SpotIntensities::Outcome seen = spots_.run(difference_.grey, frame.view, features_.value, frame.is_wrong());
    if (seen.n_lost > max_lost_) frame.flags |= kFlagMarkersLost;
    if (seen.is_light_wrong) frame.flags |= kFlagLight;
  }

 private:
  int64_t max_lost_;
  SpotIntensities spots_;
  const SlotData<Slot::kDifference>& difference_;
  SlotData<Slot::kFeatures>& features_;
};

}  // namespace

StagePointer make_spot_intensities(const StageContext& context) {
  return std::make_unique<SpotIntensitiesStage>(context);
}

}  // namespace ruffini
