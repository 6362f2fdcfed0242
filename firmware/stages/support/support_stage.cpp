// Second pass of the solve at the touched nodes (stages/support/second_pass.h). The residual is computed only on
// request.
#include <optional>

#include "core/stages.h"
#include "stages/support/second_pass.h"

namespace ruffini {
namespace {

class SupportStage final : public Stage {
 public:
  explicit SupportStage(const StageContext& c)
      : board_(c.board),
        displacement_(c.slots.read<Slot::kDisplacement>()),
        solve_(c.slots.amend<Slot::kNodeForces>()),
        residual_(c.slots.write<Slot::kResidual>()) {}

  Status load(const Calibration& calibration) override {
    if (!calibration.has_kind("support")) return Unit{};
    if (Status loaded = keep(SecondPass::load(calibration, board_), pass_); !loaded) return loaded;
    solve_.is_at_finite_strain = pass_->is_at_finite_strain();
    return Unit{};
  }

  [[nodiscard]] bool writes(Slot /*slot*/) const override { return pass_.has_value(); }

  void begin() override {
    solve_.is_refined = false;
    solve_.is_explained = true;
    residual_.validity = Validity::kNotMeasured;
  }

  void run(Frame& frame) override {
    if (!displacement_.has_depth && !frame.is_displacement_given) return;
    pass_->refine(solve_, frame.saturations);
    if (!solve_.is_explained) frame.flags |= kFlagFeatures;
    pass_->average(!frame.is_wrong(), solve_, frame.saturations);
    // An untrusted frame does not enter the history.
    if (!pass_->has_relaxation() || frame.capture_us == 0 || frame.is_wrong()) return;
    pass_->apply_relaxation(frame.capture_us, solve_, frame.saturations);
  }

  void compute(Slot /*slot*/, const Frame& frame) override {
    residual_.validity = Validity::kNotMeasured;
    if (!solve_.is_refined) return;
    SaturationCounter saturations;  // separate, because they do not affect the forces
    pass_->compute_residual(solve_, residual_.node, saturations);
    residual_.validity = frame.is_wrong() || saturations.count != 0 ? Validity::kInvalid : Validity::kValid;
  }

  // Flags that came after run().
  void judge(uint32_t& flags) override {
    if (pass_ && (flags & kWrongFlags) != 0) pass_->distrust();
  }
  void forget() override { pass_->forget(); }

 private:
  BoardSettings board_;
  std::optional<SecondPass> pass_;
  const SlotData<Slot::kDisplacement>& displacement_;
  SlotData<Slot::kNodeForces>& solve_;
  SlotData<Slot::kResidual>& residual_;
};

}  // namespace

StagePointer make_support(const StageContext& context) { return std::make_unique<SupportStage>(context); }

}  // namespace ruffini
