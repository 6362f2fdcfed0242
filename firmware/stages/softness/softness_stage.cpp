// Modulus of the squeezed object (stages/softness/softness.h). The result of a squeeze stands until the next one.
#include <optional>

#include "core/stages.h"
#include "solve/node_sigma.h"
#include "stages/softness/softness.h"

namespace ruffini {
namespace {

constexpr size_t kForceZ = 11;  // index (2, 2) of the covariance's upper triangle by rows

class SoftnessStage final : public Stage {
 public:
  explicit SoftnessStage(const StageContext& c)
      : cells_(c.board.picture_features.cells),
        features_(c.slots.read<Slot::kFeatures>()),
        wrench_(c.slots.read<Slot::kWrench>()),
        covariance_(c.slots.read<Slot::kCovariance>()),
        out_(c.slots.write<Slot::kSoftness>()) {}

  Status load(const Calibration& calibration) override { return keep(Softness::load(calibration, cells_), softness_); }
  [[nodiscard]] bool writes(Slot /*slot*/) const override { return softness_.has_value(); }

  void run(Frame& frame) override {
    if (frame.is_wrong() || (frame.flags & kFlagTemperature) != 0) {
      softness_->discard_rise();
      return;
    }
    softness_->run(features_.value, -wrench_.sum.force_z_un, floor_sqrt(covariance_.wrench.upper[kForceZ]));
    out_.squeeze = softness_->result();
  }

  void judge(uint32_t& flags) override { out_.validity = validity_of(flags, out_.squeeze.n_frames > 0); }

  void forget() override {
    if (softness_) softness_->forget();
    out_.squeeze = {};
  }

 private:
  GridSize cells_;
  std::optional<Softness> softness_;
  const SlotData<Slot::kFeatures>& features_;
  const SlotData<Slot::kWrench>& wrench_;
  const SlotData<Slot::kCovariance>& covariance_;
  SlotData<Slot::kSoftness>& out_;
};

}  // namespace

StagePointer make_softness(const StageContext& context) { return std::make_unique<SoftnessStage>(context); }

}  // namespace ruffini
