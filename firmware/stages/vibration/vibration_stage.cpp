// Vibration of a contact (stages/vibration/vibration.h), measured between two consecutive frames with contact.
#include "core/stages.h"
#include "stages/vibration/vibration.h"

namespace ruffini {
namespace {

class VibrationStage final : public Stage {
 public:
  explicit VibrationStage(const StageContext& c)
      : vibration_(c.board.camera.width_px, c.board.camera.height_px),
        difference_(c.slots.read<Slot::kDifference>()),
        contacts_(c.slots.read<Slot::kContacts>()),
        out_(c.slots.write<Slot::kVibration>()) {}

  void run(Frame& frame) override {
    const bool is_touched = contacts_.n_found > 0 && !frame.is_wrong();
    out_.level_cdb = vibration_.run(difference_.grey);
    is_measured_ = is_touched && was_touched_;
    was_touched_ = is_touched;
  }

  void judge(uint32_t& flags) override { out_.validity = validity_of(flags, is_measured_); }

  void forget() override { was_touched_ = is_measured_ = false; }

 private:
  Vibration vibration_;
  bool was_touched_ = false;
  bool is_measured_ = false;
  const SlotData<Slot::kDifference>& difference_;
  const SlotData<Slot::kContacts>& contacts_;
  SlotData<Slot::kVibration>& out_;
};

}  // namespace

StagePointer make_vibration(const StageContext& context) { return std::make_unique<VibrationStage>(context); }

}  // namespace ruffini
