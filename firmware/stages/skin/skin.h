// Detects the touches of a skin that becomes brighter where it is pressed.
//
//   glow (image/glow.h), then, depending on the calibration,
//     taxels    image/taxels.h, stages/skin/taxel_touches.h, stages/skin/opening_edges.h   if it has skin.run
//     picture   image/glow_regions.h, stages/skin/skin_image.h                           otherwise: the paper's method
//   identity of touches and mean over frames (stages/skin/skin_track.h)
//
// Without a calibration, touches are detected but have neither position nor force. A frame is dark if a taxel or the
// whole skin lost half its light. Its light is wrong if light enters from outside, if the whole skin is brighter or
// darker than at rest by kWrongLight, or if the curve of grey levels has changed. Frame thread; no allocation after
// load().
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>

#include "base/image_view.h"
#include "board/settings.h"
#include "core/results.h"
#include "image/glow.h"
#include "image/glow_regions.h"
#include "image/taxels.h"
#include "stages/skin/opening_edges.h"
#include "stages/skin/skin_image.h"
#include "stages/skin/skin_track.h"
#include "stages/skin/taxel_touches.h"

namespace ruffini {

class Skin {
 public:
  static constexpr int64_t kWrongLightQ12 = 1024;  // a quarter

  [[nodiscard]] static Result<Skin> load(const BoardSettings& board, const Calibration* calibration);

  // Sets the untouched image, width x height x 3 in 1/16 levels.
  void learn(std::span<const uint16_t> rest);
  const SkinFrame& run(const FrameView& frame, uint64_t capture_us, SaturationCounter& saturations);

  [[nodiscard]] bool is_calibrated() const { return touches_ || image_; }
  [[nodiscard]] bool has_taxels() const { return taxels_.has_value(); }
  [[nodiscard]] const SkinFrame& frame() const { return frame_; }
  [[nodiscard]] std::span<const int32_t> ratio() const {
    return taxels_ ? taxels_->ratio() : std::span<const int32_t>();
  }
  [[nodiscard]] std::span<const int16_t> glow() const { return glow_.plane(); }
  [[nodiscard]] std::span<const int16_t> smoothed() const { return glow_.smoothed(); }
  [[nodiscard]] const GlowRegions& regions() const { return regions_; }

 private:
  explicit Skin(const BoardSettings& board);
  void check_picture();

  Glow glow_;
  GlowRegions regions_;
  SkinTrack track_;
  std::optional<SkinImage> image_;
  std::optional<Taxels> taxels_;
  std::optional<TaxelTouches> touches_;
  std::optional<OpeningEdges> edges_;  // with taxels
  SkinFrame frame_;
};

}  // namespace ruffini
