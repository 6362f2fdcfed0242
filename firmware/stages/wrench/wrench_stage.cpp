// Force and moment of the whole pad from its nodal forces (estimators/wrench.h).
#include "core/stages.h"
#include "estimators/wrench.h"

namespace ruffini {
namespace {

class WrenchStage final : public Stage {
 public:
  explicit WrenchStage(const StageContext& c)
      : nodes_(c.board),
        force_lsb_un_(c.board.force_lsb_un),
        solve_(c.slots.read<Slot::kNodeForces>()),
        displacement_(c.slots.read<Slot::kDisplacement>()),
        force_(c.slots.read<Slot::kForceValidity>()),
        wrench_(c.slots.write<Slot::kWrench>()) {}

  void run(Frame& frame) override {
    wrench_.sum = sum_wrench(nodes_, solve_.force, force_lsb_un_);
    if (!solve_.is_at_finite_strain) return;
    add_displacement_moment(solve_.force, displacement_.node, force_lsb_un_, wrench_.sum, frame.saturations);
  }

  void judge(uint32_t& /*flags*/) override {
    wrench_.validity = {force_.xy, force_.xy, force_.z, force_.z, force_.z, force_.xy};
  }

 private:
  NodeGrid nodes_;
  int64_t force_lsb_un_;
  const SlotData<Slot::kNodeForces>& solve_;
  const SlotData<Slot::kDisplacement>& displacement_;
  const SlotData<Slot::kForceValidity>& force_;
  SlotData<Slot::kWrench>& wrench_;
};

}  // namespace

StagePointer make_wrench(const StageContext& context) { return std::make_unique<WrenchStage>(context); }

}  // namespace ruffini
