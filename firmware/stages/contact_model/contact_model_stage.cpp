// One contact from the flow of a texture: its profile (stages/contact_model/contact_profile.h) and, with the tables,
// depth, width and hardness (stages/contact_model/contact_model.h). Its forces come from the wrench: there is no force
// field.
#include <optional>

#include "core/stages.h"
#include "stages/contact_model/contact_model.h"
#include "stages/contact_model/contact_profile.h"

namespace ruffini {
namespace {

class ContactModelStage final : public Stage {
 public:
  explicit ContactModelStage(const StageContext& c)
      : profiler_(c.board),
        markers_(c.slots.read<Slot::kMarkers>()),
        wrench_(c.slots.read<Slot::kWrench>()),
        profile_(c.slots.write<Slot::kProfile>()),
        modelled_(c.slots.write<Slot::kContactModel>()),
        contacts_(c.slots.write<Slot::kContacts>()) {}

  Status load(const Calibration& calibration) override {
    if (!calibration.has_kind("wrench")) {
      return Error{
          ErrorKind::kBadInput,
          "calibration file: contact_model without wrench: make it again with `ruffini cal fit --only contact --log`"};
    }
    return keep(ContactModel::load(calibration), model_);
  }

  [[nodiscard]] bool writes(Slot slot) const override { return slot == Slot::kProfile || model_.has_value(); }

  void run(Frame& frame) override {
    profile_ = profiler_.run(markers_.marker);
    profile_.flow = profiler_.flow();
    profile_.fall = profiler_.fall();
    if (!model_) return;
    contacts_ = {};
    modelled_ = model_->run(profile_, wrench_.sum, !frame.is_wrong(), frame.capture_us, frame.saturations);
    modelled_.inputs = model_->inputs();
    if (modelled_.is_covered) frame.flags |= kFlagMarkersLost;
    if (modelled_.is_over_range) frame.flags |= kFlagOverRange;
    if (!modelled_.is_touched) return;
    contacts_.n_listed = contacts_.n_found = 1;
    contacts_.contacts[0] = {.area_um2 = modelled_.area_um2,
                             .center_x_um = profile_.center_x_um,
                             .center_y_um = profile_.center_y_um,
                             .force_x_un = wrench_.sum.force_x_un,
                             .force_y_un = wrench_.sum.force_y_un,
                             .force_z_un = wrench_.sum.force_z_un,
                             .peak_depth_nm = -1'000 * modelled_.gel_depth_um};
  }

  void judge(uint32_t& flags) override {
    if (!model_) return;
    const auto validity = [&](bool is_measured) {
      return is_measured && modelled_.is_strange ? Validity::kInvalid : validity_of(flags, is_measured);
    };
    modelled_.depth_validity = validity(modelled_.is_touched);
    modelled_.hardness_validity = validity(modelled_.is_touched && modelled_.has_hardness);
  }

  void forget() override {
    if (model_) model_->forget();
    modelled_ = {};
  }

 private:
  ContactProfile profiler_;
  std::optional<ContactModel> model_;
  const SlotData<Slot::kMarkers>& markers_;
  const SlotData<Slot::kWrench>& wrench_;
  SlotData<Slot::kProfile>& profile_;
  SlotData<Slot::kContactModel>& modelled_;
  SlotData<Slot::kContacts>& contacts_;
};

}  // namespace

StagePointer make_contact_model(const StageContext& context) { return std::make_unique<ContactModelStage>(context); }

}  // namespace ruffini
