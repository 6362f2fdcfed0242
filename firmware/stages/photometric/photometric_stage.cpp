// Surface slopes from colours (image/photometric.h), as an ideal pinhole sees them; or, with a depth table, directly
// the depth that stage poisson would compute.
#include <optional>

#include "core/stages.h"
#include "image/photometric.h"
#include "image/slope_rectifier.h"

namespace ruffini {
namespace {

class PhotometricStage final : public Stage {
 public:
  explicit PhotometricStage(const StageContext& c)
      : board_(c.board),
        difference_(c.slots.read<Slot::kDifference>()),
        light_(c.slots.read<Slot::kLight>()),
        markers_(c.slots.read<Slot::kMarkers>()),
        targets_(c.slots.read<Slot::kTargets>()),
        slope_(c.slots.write<Slot::kSlope>()) {
    slope_.slope.resize(n_cells());
  }

  Status load(const Calibration& calibration) override {
    if (calibration.has_kind("camera")) {
      if (Status map = keep(SlopeRectifier::load(calibration, board_), rectifier_); !map) return map;
    }
    if (!calibration.has_kind("photometric")) return Unit{};
    const auto table = PhotometricTable::load(calibration);
    if (!table) return table.error();
    photometric_.emplace(board_, table.value());
    slope_.is_balanced = photometric_->is_balanced();
    slope_.is_of_depth = photometric_->is_of_depth();
    if (slope_.is_of_depth) slope_.depth.resize(n_cells());
    slope_.is_foreign_optics = calibration.text("optics") != board_.camera.optics;
    return Unit{};
  }

  [[nodiscard]] bool writes(Slot /*slot*/) const override { return photometric_.has_value(); }

  void run(Frame& /*frame*/) override {
    if (slope_.is_of_depth) {
      photometric_->run_depth(difference_.change, light_.level, slope_.depth);
      return;
    }
    const std::span<const Marker> hidden = targets_.mark.empty() ? markers_.marker : targets_.mark;
    photometric_->run(difference_.change, hidden, light_.level, slope_.slope);
    if (rectifier_) rectifier_->run(slope_.slope);
  }

 private:
  [[nodiscard]] size_t n_cells() const {
    const int step_px = board_.depth.step_px;
    return static_cast<size_t>(board_.camera.width_px / step_px * (board_.camera.height_px / step_px));
  }

  BoardSettings board_;
  std::optional<Photometric> photometric_;
  std::optional<SlopeRectifier> rectifier_;
  const SlotData<Slot::kDifference>& difference_;
  const SlotData<Slot::kLight>& light_;
  const SlotData<Slot::kMarkers>& markers_;
  const SlotData<Slot::kTargets>& targets_;
  SlotData<Slot::kSlope>& slope_;
};

}  // namespace

StagePointer make_photometric(const StageContext& context) { return std::make_unique<PhotometricStage>(context); }

}  // namespace ruffini
