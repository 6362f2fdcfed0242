// Depth map from the flow of a texture under one contact (stages/contact_depth/contact_depth.h); zero without contact.
// Not for boards whose depth comes from light.
#include <algorithm>
#include <optional>

#include "core/stages.h"
#include "stages/contact_depth/contact_depth.h"

namespace ruffini {
namespace {

class ContactDepthStage final : public Stage {
 public:
  explicit ContactDepthStage(const StageContext& c)
      : board_(c.board),
        profile_(c.slots.read<Slot::kProfile>()),
        modelled_(c.slots.read<Slot::kContactModel>()),
        depth_(c.slots.write<Slot::kDepth>()) {
    if (!ContactDepth::is_used_by(board_)) return;
    depth_.step_px = ContactDepth::step_px(board_);
    depth_.grid = ContactDepth::cells(board_);
    depth_.cell.resize(static_cast<size_t>(depth_.grid.count()));
  }

  Status load(const Calibration& calibration) override {
    if (!ContactDepth::is_used_by(board_)) return Unit{};
    if (Status loaded = keep(ContactDepth::load(calibration, board_), map_); !loaded) return loaded;
    depth_.sigma_um = map_->sigma_um();
    return Unit{};
  }

  [[nodiscard]] bool writes(Slot /*slot*/) const override { return map_.has_value(); }

  void run(Frame& frame) override {
    if (modelled_.is_touched) {
      map_->run(profile_, modelled_.inputs, depth_.cell, frame.saturations);
    } else {
      std::fill(depth_.cell.begin(), depth_.cell.end(), DisplacementUm{});
    }
  }

  void judge(uint32_t& flags) override {
    depth_.validity = modelled_.is_strange ? Validity::kInvalid : validity_of(flags, true);
  }

 private:
  BoardSettings board_;
  std::optional<ContactDepth> map_;
  const SlotData<Slot::kProfile>& profile_;
  const SlotData<Slot::kContactModel>& modelled_;
  SlotData<Slot::kDepth>& depth_;
};

}  // namespace

StagePointer make_contact_depth(const StageContext& context) { return std::make_unique<ContactDepthStage>(context); }

}  // namespace ruffini
