// Uncertainty of the refined forces and of the wrench (solve/node_sigma.h, estimators/wrench_covariance.h), and whether
// the camera has moved against the pad (estimators/camera_motion.h). Part of the stage support, after the wrench and
// contacts. Adds the relative standard deviation of the pad's stiffness to the error model: the calibration's
// support.stiffness_sigma_1e6, or the board's if the file has none.
#include <algorithm>
#include <array>
#include <optional>

#include "core/stages.h"
#include "estimators/camera_motion.h"
#include "estimators/wrench_covariance.h"
#include "solve/contact_mask.h"
#include "solve/node_sigma.h"

namespace ruffini {
namespace {

// Loads all of them or none; without them uncertainty is not measured.
constexpr std::array kErrorTensors = {"support.error_reported", "support.error_quiet", "support.error_local",
                                      "support.error_wrench"};
constexpr const char* kStiffnessSigma = "support.stiffness_sigma_1e6";
constexpr int64_t kMaxStiffnessSigma_1e6 = 500'000;

class UncertaintyStage final : public Stage {
 public:
  explicit UncertaintyStage(const StageContext& c)
      : pad_(c.board.pad),
        grid_(c.board),
        nodes_(grid_.size()),
        force_lsb_un_(c.board.force_lsb_un),
        threshold_lsb_(contact_threshold_lsb(c.board.contact.threshold_un, c.board.force_lsb_un)),
        camera_motion_(nodes_),
        solve_(c.slots.read<Slot::kNodeForces>()),
        displacement_(c.slots.read<Slot::kDisplacement>()),
        wrench_(c.slots.read<Slot::kWrench>()),
        contacts_(c.slots.read<Slot::kContacts>()),
        uncertainty_(c.slots.write<Slot::kNodeSigma>()),
        covariance_(c.slots.write<Slot::kCovariance>()) {}

  Status load(const Calibration& calibration) override {
    const auto is_there = [&](const char* name) { return calibration.tensor(name) != nullptr; };
    if (std::none_of(kErrorTensors.begin(), kErrorTensors.end(), is_there)) return Unit{};
    int64_t stiffness_1e6 = pad_.stiffness_sigma_1e3 * 1'000;
    if (!calibration.text(kStiffnessSigma).empty()) {
      const auto stated = calibration.integer(kStiffnessSigma, 0, kMaxStiffnessSigma_1e6);
      if (!stated) return stated.error();
      stiffness_1e6 = stated.value();
    }
    const int64_t stiffness_q20 = (stiffness_1e6 << 20) / 1'000'000;
    Status nodes = keep(NodeSigmaModel::load(calibration, nodes_, threshold_lsb_, stiffness_q20), node_error_);
    return nodes ? keep(WrenchErrorModel::load(calibration, pad_, stiffness_q20), wrench_error_) : nodes;
  }

  [[nodiscard]] bool writes(Slot /*slot*/) const override { return wrench_error_.has_value(); }

  void begin() override { uncertainty_.is_stated = covariance_.is_stated = false; }

  void run(Frame& frame) override {
    if (!solve_.is_refined) return;
    uncertainty_.is_stated = covariance_.is_stated = true;
    if (camera_motion_.has_moved(solve_.residual_at_sides, solve_.mask, wrench_.sum)) frame.flags |= kFlagFeatures;
    const std::span<const uint8_t> filled = displacement_.filled;
    node_error_->run(solve_.force, filled, uncertainty_.node);
    covariance_.wrench =
        wrench_error_->run(wrench_.sum, contacts_, sum_filled(grid_, solve_.force, filled, force_lsb_un_));
  }

  void judge(uint32_t& flags) override {
    uncertainty_.validity = covariance_.validity = validity_of(flags, uncertainty_.is_stated);
  }

 private:
  PadSettings pad_;
  NodeGrid grid_;
  GridSize nodes_;
  int64_t force_lsb_un_;
  int64_t threshold_lsb_;
  CameraMotion camera_motion_;
  std::optional<NodeSigmaModel> node_error_;
  std::optional<WrenchErrorModel> wrench_error_;
  const SlotData<Slot::kNodeForces>& solve_;
  const SlotData<Slot::kDisplacement>& displacement_;
  const SlotData<Slot::kWrench>& wrench_;
  const SlotData<Slot::kContacts>& contacts_;
  SlotData<Slot::kNodeSigma>& uncertainty_;
  SlotData<Slot::kCovariance>& covariance_;
};

}  // namespace

StagePointer make_uncertainty(const StageContext& context) { return std::make_unique<UncertaintyStage>(context); }

}  // namespace ruffini
