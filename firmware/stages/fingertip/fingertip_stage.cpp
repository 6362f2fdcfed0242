// Touch of a tool on a round fingertip (stages/fingertip/fingertip.h), using the eyes that see. The touch is reported
// as a contact on the undeformed dome, seen from above; of the wrench only the force along z is measured.
#include <array>
#include <optional>

#include "core/stages.h"
#include "stages/fingertip/fingertip.h"

namespace ruffini {
namespace {

constexpr size_t kForceZAlone = 11;  // index (2, 2) of the covariance's upper triangle by rows
constexpr int kMaxUnsureAlone = 1;   // pins of an eye that sees alone, e.g. one at the edge of its view

class FingertipStage final : public Stage {
 public:
  explicit FingertipStage(const StageContext& c)
      : radius_um_(c.board.pad.size_x_um / 2),
        max_lost_(c.board.markers.max_lost),
        markers_(c.slots.read<Slot::kMarkers>()),
        tip_(c.slots.write<Slot::kToolTouch>()),
        contacts_(c.slots.write<Slot::kContacts>()),
        wrench_(c.slots.write<Slot::kWrench>()),
        covariance_(c.slots.write<Slot::kCovariance>()),
        force_(c.slots.write<Slot::kForceValidity>()) {}

  Status load(const Calibration& calibration) override { return keep(Fingertip::load(calibration), fingertip_); }
  [[nodiscard]] bool writes(Slot /*slot*/) const override { return fingertip_.has_value(); }

  void learn(std::span<const uint16_t> /*rest*/) override {
    fingertip_->learn(markers_.marker);
    const auto eyes = seeing_eyes([&](size_t eye) { return markers_.view[eye].was_seen_at_rest; });
    is_other_pad_ = eyes && fingertip_->is_other_pad(*eyes);
  }

  void run(Frame& frame) override {
    if (is_other_pad_) frame.flags |= kFlagOtherPad;
    tip_ = {};
    contacts_ = {};
    wrench_.sum = {};
    covariance_.wrench = {};
    const auto eyes = seeing_eyes([&](size_t eye) { return !markers_.is_blind(eye, max_lost_); });
    if (!eyes) return;
    tip_ = fingertip_->run(markers_.marker, *eyes, frame.saturations);
    if (are_pins_doubtful(*eyes)) frame.flags |= kFlagMarkersLost;
    if (tip_.has_camera_moved) frame.flags |= kFlagFeatures;
    if (!tip_.is_touched) return;
    if (!tip_.is_known) frame.flags |= kFlagFeatures;
    if (!tip_.is_in_range) frame.flags |= kFlagOverRange;
    wrench_.sum.force_z_un = -(tip_.force_un * tip_.axis_1e6[2] / 1'000'000);
    const int64_t sigma_un = tip_.sigma[0] * tip_.axis_1e6[2] / 1'000'000;
    covariance_.wrench.upper[kForceZAlone] = sigma_un * sigma_un;
    contacts_ = {.n_listed = 1, .n_found = 1};
    contacts_.contacts[0] = {.area_um2 = tip_.area_um2,
                             .center_x_um = round_shift(radius_um_ * tip_.place_q14[0], 14),
                             .center_y_um = round_shift(radius_um_ * tip_.place_q14[1], 14),
                             .force_z_un = wrench_.sum.force_z_un,
                             .peak_depth_nm = -1'000 * tip_.travel_um};
  }

  void judge(uint32_t& flags) override {
    flags &= ~(kFlagUncalibratedXy | kFlagUncalibratedZ);
    // One eye alone cannot exclude a touch that it does not see.
    const bool is_unseen = !tip_.is_touched && (flags & kFlagViewLost) != 0;
    force_.xy = Validity::kNotMeasured;
    force_.z = is_unseen ? Validity::kInvalid : validity_of(flags, true);
    wrench_.validity.fill(Validity::kNotMeasured);
    wrench_.validity[2] = force_.z;
    covariance_.is_stated = tip_.is_touched;
    covariance_.validity = tip_.is_touched ? force_.z : Validity::kNotMeasured;
  }

 private:
  // If some pins are known to be wrong, others may be too; a single eye has less to contradict it.
  [[nodiscard]] bool are_pins_doubtful(Eyes eyes) const {
    const int n_contradicted = fingertip_->n_contradicted();
    if (eyes == Eyes::kBoth) {
      return markers_.view[0].n_low_confidence + markers_.view[1].n_low_confidence + n_contradicted > max_lost_;
    }
    return markers_.view[eyes == Eyes::kLeft ? 0 : 1].n_low_confidence > kMaxUnsureAlone || n_contradicted > max_lost_;
  }

  int64_t radius_um_;
  int64_t max_lost_;
  bool is_other_pad_ = false;
  std::optional<Fingertip> fingertip_;
  const SlotData<Slot::kMarkers>& markers_;
  SlotData<Slot::kToolTouch>& tip_;
  SlotData<Slot::kContacts>& contacts_;
  SlotData<Slot::kWrench>& wrench_;
  SlotData<Slot::kCovariance>& covariance_;
  SlotData<Slot::kForceValidity>& force_;
};

}  // namespace

StagePointer make_fingertip(const StageContext& context) { return std::make_unique<FingertipStage>(context); }

}  // namespace ruffini
