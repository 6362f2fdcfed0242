// The stage of a skin that gets brighter where it is pressed: from a frame to its touches.
//
//   glow (image/glow.h), then, by what the calibration brings,
//     taxels    image/taxels.h, stages/skin/taxel_touches.h      where it has skin.run
//     picture   image/glow_regions.h, stages/skin/skin_image.h   else: the paper's own method
//   who is who and the mean over frames (stages/skin/skin_track.h)
//
// Without a calibration touches are seen but have neither place nor force. A frame is dark where half a panel's worth
// of light is missing on a taxel, and its light is off where light comes in from outside or all of the skin
// is kLightOff brighter or darker than at rest. Frame thread; no allocation after load().
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
#include "stages/skin/skin_image.h"
#include "stages/skin/skin_track.h"
#include "stages/skin/taxel_touches.h"

namespace ruffini {

class Skin {
 public:
  static constexpr int64_t kLightOffQ12 = 1024;  // a quarter

  [[nodiscard]] static Result<Skin> load(const BoardSettings& board, const Calibration* calibration);

  // The untouched image, width x height x 3 in 1/16 levels.
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
  void judge_light();

  Glow glow_;
  GlowRegions regions_;
  SkinTrack track_;
  std::optional<SkinImage> image_;
  std::optional<Taxels> taxels_;
  std::optional<TaxelTouches> touches_;
  SkinFrame frame_;
};

}  // namespace ruffini
