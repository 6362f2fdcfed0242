// Touches of a skin that becomes brighter where it is pressed (stages/skin/skin.h). Touches are reported as contacts of
// the unrolled skin, whose z axis is the outward normal everywhere; only pressing is measured.
#include <utility>

#include "core/stages.h"
#include "stages/skin/skin.h"

namespace ruffini {
namespace {

class SkinStage final : public Stage {
 public:
  explicit SkinStage(const StageContext& c)
      : board_(c.board),
        skin_(Skin::load(c.board, nullptr).value()),
        frame_(c.slots.write<Slot::kSkin>()),
        contacts_(c.slots.write<Slot::kContacts>()),
        wrench_(c.slots.write<Slot::kWrench>()),
        force_(c.slots.write<Slot::kForceValidity>()) {
    show();
  }

  Status load(const Calibration& calibration) override {
    auto loaded = Skin::load(board_, &calibration);
    if (!loaded) return loaded.error();
    skin_ = std::move(loaded).value();
    show();
    return Unit{};
  }

  void learn(std::span<const uint16_t> rest) override { skin_.learn(rest); }

  void run(Frame& frame) override {
    frame_ = skin_.run(frame.view, frame.capture_us, frame.saturations);
    show();
    if (frame_.is_dark) frame.flags |= kFlagDark;
    if (frame_.is_light_wrong) frame.flags |= kFlagLight;
    if (frame_.has_moved) frame.flags |= kFlagFeatures;
    const SkinTouchList& touches = frame_.touches;
    contacts_ = {.n_listed = touches.n_listed, .n_found = touches.n_found};
    wrench_.sum = {};
    for (size_t i = 0; i < static_cast<size_t>(touches.n_listed); ++i) {
      const SkinTouch& t = touches.touch[i];
      contacts_.contacts[i] = {
          .area_um2 = t.area_um2, .center_x_um = t.x_um, .center_y_um = t.y_um, .force_z_un = -t.press_un};
      wrench_.sum.force_z_un -= t.press_un;
    }
  }

  void judge(uint32_t& flags) override {
    if (skin_.is_calibrated()) flags &= ~(kFlagUncalibratedXy | kFlagUncalibratedZ);
    force_.xy = Validity::kNotMeasured;
    force_.z = validity_of(flags, skin_.is_calibrated());
    wrench_.validity.fill(Validity::kNotMeasured);
    wrench_.validity[2] = force_.z;
  }

 private:
  void show() {
    frame_.ratio = skin_.ratio();
    frame_.glow = skin_.has_taxels() ? skin_.glow() : skin_.smoothed();
  }

  BoardSettings board_;
  Skin skin_;
  SlotData<Slot::kSkin>& frame_;
  SlotData<Slot::kContacts>& contacts_;
  SlotData<Slot::kWrench>& wrench_;
  SlotData<Slot::kForceValidity>& force_;
};

}  // namespace

StagePointer make_skin(const StageContext& context) { return std::make_unique<SkinStage>(context); }

}  // namespace ruffini
