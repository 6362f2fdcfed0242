// Wrench of the features that another stage writes (stages/feature_wrench/feature_wrench.h), for boards without a field
// of forces; of markers, whether the camera has moved against the pad (stages/feature_wrench/corner_motion.h).
#include <algorithm>
#include <optional>

#include "core/stages.h"
#include "stages/feature_wrench/corner_motion.h"
#include "stages/feature_wrench/feature_wrench.h"

namespace ruffini {
namespace {

constexpr int64_t kMaxForceUn = 2'000'000'000;  // its square fits

// Further from zero than five standard deviations.
bool is_beyond_noise(int64_t force_un, int64_t variance_un2) {
  const int64_t f = std::clamp<int64_t>(force_un, -kMaxForceUn, kMaxForceUn);
  return f * f / 25 > variance_un2;
}

class FeatureWrenchStage final : public Stage {
 public:
  explicit FeatureWrenchStage(const StageContext& c)
      : layout_(c.board.markers),
        features_(c.slots.read<Slot::kFeatures>()),
        markers_(c.slots.read<Slot::kMarkers>()),
        wrench_(c.slots.write<Slot::kWrench>()),
        covariance_(c.slots.write<Slot::kCovariance>()) {}

  Status load(const Calibration& calibration) override {
    const bool is_lattice = !markers_.marker.empty() && !layout_.has_views && !layout_.is_scattered;
    if (is_lattice) corner_motion_.emplace(layout_.lattice);
    const auto n = static_cast<int>(features_.value.size());
    return keep(FeatureWrench::load(calibration, features_.sort.name, n), map_);
  }

  [[nodiscard]] bool writes(Slot /*slot*/) const override { return map_.has_value(); }

  void learn(std::span<const uint16_t> /*rest*/) override {
    if (corner_motion_) corner_motion_->learn(markers_.marker, *map_);
  }

  void run(Frame& frame) override {
    // A frame that is wrong is not remembered.
    const uint64_t capture_us = frame.is_wrong() ? 0 : frame.capture_us;
    const FeatureWrench::Outcome said = map_->run(features_.value, frame.warmth, capture_us, frame.saturations);
    wrench_.sum = said.wrench;
    covariance_.wrench = said.covariance;
    covariance_.is_stated = true;
    const auto& variance = said.covariance.upper;
    wrench_.is_beyond_noise = is_beyond_noise(said.wrench.force_x_un, variance[0]) ||
                              is_beyond_noise(said.wrench.force_y_un, variance[6]) ||
                              is_beyond_noise(said.wrench.force_z_un, variance[11]);
    const bool has_moved = corner_motion_ && corner_motion_->has_moved(markers_.marker, said.wrench);
    if (!said.is_in_agreement || has_moved) frame.flags |= kFlagFeatures;
    if (!said.is_in_range) frame.flags |= kFlagOverRange;
    if (!said.is_warmth_known) frame.flags |= kFlagTemperature;
  }

  void judge(uint32_t& flags) override {
    flags &= ~(kFlagUncalibratedXy | kFlagUncalibratedZ);
    const bool is_calibrated = (flags & kFlagTemperature) == 0;
    for (size_t i = 0; i < wrench_.validity.size(); ++i) {
      wrench_.validity[i] = validity_of(flags, map_->measures(i), is_calibrated);
    }
    covariance_.validity = validity_of(flags, covariance_.is_stated);
  }

  void forget() override { map_->forget(); }

 private:
  MarkerSettings layout_;
  std::optional<FeatureWrench> map_;
  std::optional<CornerMotion> corner_motion_;  // where the features are markers of one lattice
  const SlotData<Slot::kFeatures>& features_;
  const SlotData<Slot::kMarkers>& markers_;
  SlotData<Slot::kWrench>& wrench_;
  SlotData<Slot::kCovariance>& covariance_;
};

}  // namespace

StagePointer make_feature_wrench(const StageContext& context) { return std::make_unique<FeatureWrenchStage>(context); }

}  // namespace ruffini
