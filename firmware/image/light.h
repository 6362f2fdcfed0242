// Follows the drift of lamps and exposure: one gain per channel, updated while nothing touches the pad.
//
//   sample    mean change of 8 x 2 pixels, one for each 16 x 8; used if rest has 32 to 220 grey levels in all of them
//             and no edge of a dot
//   m         median of a channel's samples
//   uniform   samples within 1.5 % of their channel's m
//   still     frame with at least 7/8 of the samples of every channel uniform, and no marker (of boards with targets:
//             target) more than 1/4 px from its rest position
//   gain_c += clamp(m_c, +-1/128) / 16 in every frame from the 16th consecutive still one; 0.75 <= gain_c <= 1.25.
//             Without visible markers 127/128 of the samples must be uniform: a small contact may change the whole
//             picture a little
//
// image/light_map.h follows each channel's drift over the picture.
//
// One gain per channel cannot take a contact's shape, and a moved marker or a shaded eighth (without visible markers:
// 1/128) of the picture stops it: a static contact is not learned, unless it changes less than that. At 60 Hz it
// follows 2.9 % per second. `is_wrong`: the light differs from that at rest and has not been followed yet, any of:
//   the frame is still, and |m| > 4 % in a channel
//   at least half of the samples are uniform, and |m_B + m_G + m_R| > 18 %: no slope of the surface does that, because
//     it takes from one lamp what it gives to another
//   markers are seen, all at rest, and more than a sixth of the samples are not uniform, as when part of a lamp fails
//   the map's `is_wrong`
// stages/difference/light_stage.cpp adds is_lit_from_outside() and is_lit_from_one_side(). If the calibration uses the
// frame's level (below), an unreliable level replaces the first three.
//
// level(): relative change of a frame's light, computed from this frame alone, for cameras that change white balance or
// exposure with every touch. It starts from m; three times it becomes the mean of the samples that are within 8 % of it
// in all three channels.
// The calibration states whether it is used (`photometric.balance`): a contact that shades most of the picture would
// shift it.
//
// Frame thread; no allocation after the constructor. Not in the papers.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "image/light_map.h"
#include "image/markers.h"
#include "image/rest.h"

namespace ruffini {

using LightLevel = std::array<int32_t, 3>;  // relative change of B, G and R due to a frame's light, Q16

class LightTracker {
 public:
  LightTracker(int width_px, int height_px);

  // Sets a new rest image and selects the samples that are used. `has_map`: false if colours are not converted to
  // depth. Then only the gain is followed: a tray that tilts under load would look like uneven light.
  void learn(std::span<const uint16_t> rest, bool has_map);
  // `change`: planes of B, G and R relative to `rest`. Updates the gain of `rest` if it has moved by 1/4096, and its
  // map.
  void run(std::span<const RelativeChange> change, std::span<const Marker> markers, Rest& rest);

  [[nodiscard]] bool is_wrong() const { return is_wrong_ || map_.is_wrong(); }
  [[nodiscard]] const LightMap& map() const { return map_; }
  // Values for `more_q12` below. Above 2.5 % a large object raises 1 sample in 17 on the real recordings tried, presses
  // on the twin 1 in 100. Just after the hardest squeezes of a real wedge it is 1 in 6, for six frames: the gel glows
  // on when the load cell reads next to nothing, and the force of half of these frames is off by 1.6 N and more. 8 %
  // with targets: a load may bring their tray (image/targets.h) closer to all lamps.
  static constexpr int kDaylightQ12 = 102;
  static constexpr int kDaylightOnTrayQ12 = 328;
  // Returns true if an eighth of the samples exceed `level` by more than `more_q12` in all three channels. With lamps
  // of three colours at different sides, no slope of the surface does that: it takes from one lamp what it gives to
  // another.
  [[nodiscard]] bool is_lit_from_outside(int more_q12, const LightLevel& level) const;
  // 2 %: presses on the twin reach 0.9 %, recorded ones on a real pad 0.7 %.
  static constexpr int kSideQ12 = 82;
  // Returns true if the medians of two opposite outer thirds of the picture differ by more than kSideQ12 in all three
  // channels, the same third brighter in each, and both thirds have 4 samples or more. No contact that leaves half
  // of each third free causes this, nor does a camera's white balance. Not for skins that darken with depth.
  [[nodiscard]] bool is_lit_from_one_side();
  // Level of the last frame. It is unreliable if fewer than an eighth of the samples agree, or if a channel's level
  // exceeds 25 %.
  [[nodiscard]] const LightLevel& level() const { return level_; }
  [[nodiscard]] bool is_level_reliable() const { return is_level_reliable_; }
  [[nodiscard]] const Rest::Gain& gain() const { return gain_; }

 private:
  struct Level {
    int median = 0;      // Q12
    size_t n_level = 0;  // uniform samples
  };
  enum Side : uint8_t { kLeft = 1, kRight = 2, kTop = 4, kBottom = 8 };
  [[nodiscard]] std::optional<int> median_of(size_t channel, Side side);
  [[nodiscard]] bool are_unequal(Side one, Side other);
  void sample(std::span<const RelativeChange> change);
  [[nodiscard]] Level level_of(size_t channel);
  void measure(const std::array<Level, 3>& start);
  void follow(const std::array<Level, 3>& level);

  int width_px_;
  int height_px_;
  std::vector<int32_t> sample_at_;              // first pixel of each sample that is used
  std::vector<uint8_t> side_;                   // outer thirds that contain each sample: sum of Side
  std::array<std::vector<int16_t>, 3> sample_;  // per channel
  std::vector<int16_t> sorted_;
  size_t n_samples_ = 0;
  LightLevel level_{};
  bool is_level_reliable_ = false;
  int n_still_ = 0;  // frames in a row
  bool is_wrong_ = false;
  Rest::Gain gain_;
  Rest::Gain in_force_;
  LightMap map_;
};

}  // namespace ruffini
