// Nodal forces from the displacement of the nodes by the inverse FEM: f = operator u; and the contact mask
// (solve/contact_mask.h).
#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "core/stages.h"
#include "estimators/wrench.h"
#include "solve/block_program.h"
#include "solve/contact_mask.h"

namespace ruffini {
namespace {

class OperatorStage final : public Stage {
 public:
  explicit OperatorStage(const StageContext& c)
      : nodes_(NodeGrid(c.board).size()),
        force_lsb_un_(c.board.force_lsb_un),
        mask_(nodes_, contact_threshold_lsb(c.board.contact.threshold_un, force_lsb_un_), c.board.contact.min_nodes),
        wide_(3 * static_cast<size_t>(nodes_.count())),
        displacement_(c.slots.read<Slot::kDisplacement>()),
        light_(c.slots.read<Slot::kLight>()),
        solve_(c.slots.write<Slot::kNodeForces>()),
        force_(c.slots.write<Slot::kForceValidity>()) {
    solve_.mask = mask_.find(solve_.force);
  }

  Status load(const Calibration& calibration) override {
    if (!calibration.has_kind("operator")) return Unit{};
    const int n = 3 * nodes_.count();
    const std::pair<const char*, int64_t> expected[] = {{"operator.n_x", nodes_.n_x},
                                                        {"operator.n_y", nodes_.n_y},
                                                        {"operator.force_lsb_un", force_lsb_un_},
                                                        {"operator.displacement_lsb_nm", kDisplacementLsbNm}};
    for (const auto& [key, value] : expected) {
      const auto found = calibration.integer(key, value, value);
      if (!found) return found.error();
    }
    if (Status loaded = keep(BlockProgram::load(calibration, "operator", n, n), operator_); !loaded) return loaded;
    return calibration.has_kind("contact") ? mask_.load_noise(calibration, force_lsb_un_) : Status(Unit{});
  }

  [[nodiscard]] bool writes(Slot /*slot*/) const override { return operator_.has_value(); }

  void run(Frame& frame) override {
    for (size_t i = 0; i < displacement_.node.size(); ++i) {
      solve_.u[3 * i] = displacement_.node[i].x.raw();
      solve_.u[3 * i + 1] = displacement_.node[i].y.raw();
      solve_.u[3 * i + 2] = displacement_.node[i].z.raw();
    }
    const auto& touched = solve_.mask;  // of the previous frame: an existing contact continues
    if (!frame.is_displacement_given) {
      solve_.is_light_steady =
          !light_.is_drifting || std::any_of(touched.begin(), touched.end(), [](uint8_t m) { return m != 0; });
    }
    operator_->run(solve_.u, wide_);
    const auto row = [&](size_t r) { return saturate_raw<int32_t>(wide_[r], frame.saturations); };
    for (size_t i = 0; i < solve_.force.size(); ++i) solve_.force[i] = {row(3 * i), row(3 * i + 1), row(3 * i + 2)};
    solve_.mask = mask_.find(solve_.force, solve_.is_light_steady);
    solve_.threshold_lsb = mask_.threshold_lsb();
    solve_.is_pressed = mask_.is_pressed();
  }

  void judge(uint32_t& flags) override {
    flags &= ~(kFlagUncalibratedXy | (displacement_.has_depth ? kFlagUncalibratedZ : uint32_t{0}));
    force_.xy = validity_of(flags, true);
    force_.z = validity_of(flags, displacement_.has_depth);
  }

 private:
  GridSize nodes_;
  int64_t force_lsb_un_;
  ContactMask mask_;
  std::optional<BlockProgram> operator_;
  std::vector<int64_t> wide_;  // force before it is clamped to 32 bits
  const SlotData<Slot::kDisplacement>& displacement_;
  const SlotData<Slot::kLight>& light_;
  SlotData<Slot::kNodeForces>& solve_;
  SlotData<Slot::kForceValidity>& force_;
};

}  // namespace

StagePointer make_operator(const StageContext& context) { return std::make_unique<OperatorStage>(context); }

}  // namespace ruffini
