// Drift of lamps and exposure (image/light.h). This stage corrects the rest image for the next frame: the stage
// difference has compared the current one already. It runs if the calibration has kind `photometric` (colours become
// depth), on boards with targets, the edges of which depend on the light, and on boards whose features vary by lamp
// (core/stages.cpp).
#include <algorithm>
#include <cstdlib>

#include "core/stages.h"
#include "image/light.h"

namespace ruffini {
namespace {

// The light drifts if a channel's gain moves by 1/32,768 or more in each of kDriftFrames frames: since the gain follows
// a sixteenth of the deviation per frame (image/light.h), the light is then 16/32,768 = 0.05 % off. That causes depth
// like that of a faint touch. A real touch changes the median by less, or is detected within these frames.
constexpr int32_t kDriftGain = Rest::kUnitGain / 32'768;
constexpr int kDriftFrames = 8;

class LightStage final : public Stage {
 public:
  explicit LightStage(const StageContext& c)
      : makes_slopes_(c.written.has(Slot::kSlope)),
        has_features_(c.has_lamp_features),
        tracker_(c.board.camera.width_px, c.board.camera.height_px),
        rest_(c.rest),
        difference_(c.slots.read<Slot::kDifference>()),
        markers_(c.slots.read<Slot::kMarkers>()),
        targets_(c.slots.read<Slot::kTargets>()),
        colours_(c.slots.read<Slot::kSlope>()),
        light_(c.slots.write<Slot::kLight>()) {}

  Status load(const Calibration& /*calibration*/) override {
    has_colours_ = makes_slopes_;
    return Unit{};
  }
  [[nodiscard]] bool writes(Slot /*slot*/) const override { return has_colours_ || has_targets() || has_features_; }

  void learn(std::span<const uint16_t> rest) override {
    tracker_.learn(rest, has_colours_);
    light_.gain = tracker_.gain();
  }

  void run(Frame& frame) override {
    const Rest::Gain before = tracker_.gain();
    tracker_.run(difference_.change, has_targets() ? targets_.mark : markers_.marker, rest_);
    light_.gain = tracker_.gain();
    light_.level = tracker_.level();
    const bool is_balanced = colours_.is_balanced;
    const bool has_settled = std::equal(before.begin(), before.end(), light_.gain.begin(),
                                        [](int32_t a, int32_t b) { return std::abs(a - b) < kDriftGain; });
    n_drifting_ = has_settled || is_balanced ? 0 : std::min(n_drifting_ + 1, kDriftFrames);
    light_.is_drifting = n_drifting_ == kDriftFrames;
    if (is_wrong(is_balanced)) frame.flags |= kFlagLight;
  }

 private:
  [[nodiscard]] bool has_targets() const { return !targets_.target.empty(); }

  [[nodiscard]] bool is_wrong(bool is_balanced) {
    if (is_balanced ? !tracker_.is_level_reliable() || tracker_.map().is_wrong() : tracker_.is_wrong()) return true;
    const int daylight_q12 = has_targets() ? LightTracker::kDaylightOnTrayQ12 : LightTracker::kDaylightQ12;
    const LightLevel usual = is_balanced ? tracker_.level() : LightLevel{};
    if (tracker_.is_lit_from_outside(daylight_q12, usual)) return true;
    return has_colours_ && !colours_.is_of_depth && tracker_.is_lit_from_one_side();
  }

  bool makes_slopes_;
  bool has_features_;
  bool has_colours_ = false;  // colours are converted to slopes or depth
  LightTracker tracker_;
  int n_drifting_ = 0;  // consecutive frames, up to kDriftFrames
  Rest& rest_;
  const SlotData<Slot::kDifference>& difference_;
  const SlotData<Slot::kMarkers>& markers_;
  const SlotData<Slot::kTargets>& targets_;
  const SlotData<Slot::kSlope>& colours_;
  SlotData<Slot::kLight>& light_;
};

}  // namespace

StagePointer make_light(const StageContext& context) { return std::make_unique<LightStage>(context); }

}  // namespace ruffini
