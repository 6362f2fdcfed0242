// Dark discs on what carries the pad (image/targets.h), also as marks that hide the surface.
#include <algorithm>

#include "core/stages.h"
#include "image/targets.h"

namespace ruffini {
namespace {

class TargetsStage final : public Stage {
 public:
  explicit TargetsStage(const StageContext& c)
      : tracker_(c.board),
        difference_(c.slots.read<Slot::kDifference>()),
        targets_(c.slots.write<Slot::kTargets>()),
        features_(c.slots.write<Slot::kFeatures>()) {
    targets_.mark.resize(tracker_.targets().size());
    features_.value.resize(3 * targets_.mark.size());
    publish();
  }

  void learn(std::span<const uint16_t> /*rest*/) override {
    tracker_.learn(difference_.grey);
    publish();
  }

  void run(Frame& frame) override {
    targets_.n_lost = tracker_.track(difference_.grey);
    publish();
    if (tracker_.is_light_wrong()) frame.flags |= kFlagLight;
    if (targets_.n_lost > 0) frame.flags |= kFlagMarkersLost;
    const auto px = [](int64_t q16) { return ImagePx::from_raw(static_cast<int32_t>(q16)); };
    std::transform(targets_.target.begin(), targets_.target.end(), targets_.mark.begin(), [&](const Target& t) {
      return Marker{.rest_x = px(t.rest.x_q16),
                    .rest_y = px(t.rest.y_q16),
                    .displacement_x = px(t.now.x_q16 - t.rest.x_q16),
                    .displacement_y = px(t.now.y_q16 - t.rest.y_q16),
                    .is_lost = t.is_lost};
    });
    auto change = features_.value.begin();
    for (const Target& t : targets_.target) {
      for (const int64_t each :
           {t.now.x_q16 - t.rest.x_q16, t.now.y_q16 - t.rest.y_q16, t.now.area_q8 - t.rest.area_q8}) {
        *change++ = saturate_raw<int32_t>(each, frame.saturations);
      }
    }
  }

 private:
  void publish() {
    const std::span<const Target> seen = tracker_.targets();
    targets_.target.assign(seen.begin(), seen.end());
  }

  TargetTracker tracker_;
  const SlotData<Slot::kDifference>& difference_;
  SlotData<Slot::kTargets>& targets_;
  SlotData<Slot::kFeatures>& features_;
};

}  // namespace

StagePointer make_targets(const StageContext& context) { return std::make_unique<TargetsStage>(context); }

}  // namespace ruffini
