#include "stages/skin/skin.h"

#include <utility>

namespace ruffini {

Skin::Skin(const BoardSettings& board) : glow_(board), regions_(board), track_(board) {}

Result<Skin> Skin::load(const BoardSettings& board, const Calibration* calibration) {
  Skin skin(board);
  if (calibration == nullptr || !calibration->has_kind("skin")) return skin;
  if (calibration->tensor("skin.run") == nullptr) {
    auto image = SkinImage::load(*calibration, board);
    if (!image) return image.error();
    skin.image_.emplace(std::move(image).value());
    return skin;
  }
  auto taxels = Taxels::load(*calibration, board);
  if (!taxels) return taxels.error();
  auto touches = TaxelTouches::load(*calibration, board);
  if (!touches) return touches.error();
  skin.taxels_.emplace(std::move(taxels).value());
  skin.touches_.emplace(std::move(touches).value());
  skin.edges_.emplace(board.camera);
  return skin;
}

void Skin::learn(std::span<const uint16_t> rest) {
  glow_.learn(rest);
  track_.forget();
  if (!taxels_) return;
  taxels_->learn(glow_.base());
  touches_->forget();
  edges_->learn(glow_.base());
  frame_.age_q12 = taxels_->age_q12();
}

void Skin::check_picture() {
  frame_.light_q12 = taxels_->light_q12();
  const OpeningEdges::Defects edges = edges_->run(glow_.plane(), frame_.light_q12);
  frame_.has_moved = edges.has_moved;
  frame_.is_dark = taxels_->n_dark() > 0 || 2 * frame_.light_q12 < -Taxels::kOne;
  frame_.is_light_wrong = frame_.light_q12 > kWrongLightQ12 || frame_.light_q12 < -kWrongLightQ12 ||
                          taxels_->stray_q6() > touches_->tables().stray_limit_q6 || edges.is_off_curve;
}

const SkinFrame& Skin::run(const FrameView& frame, uint64_t capture_us, SaturationCounter& saturations) {
  glow_.run(frame);
  if (taxels_) {
    taxels_->run(glow_.plane());
    check_picture();
    const bool is_trusted = !frame_.is_dark && !frame_.is_light_wrong && !frame_.has_moved;
    frame_.touches = touches_->run(taxels_->ratio(), capture_us, is_trusted, saturations);
  } else {
    glow_.smooth();
    regions_.find(glow_.smoothed());
    frame_.touches = image_ ? image_->run(regions_) : SkinTouchList{};
  }
  track_.run(frame_.touches);
  return frame_;
}

}  // namespace ruffini
