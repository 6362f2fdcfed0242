// Drift of lamps and exposure: one gain per channel, followed while nothing touches.
//
//   sample = mean of d over 8 x 2 pixels, one per 16 x 8; m = median of a channel's samples
//   level:   at least 7/8 of the samples of every channel within 1.5 % of its m
//   still:   level, and no marker further than 1/4 px from its rest
//   gain_c += gain of Q20: clamp(m_c, +-1/128) / 16 a frame, after 16 still frames in a row; 0.75 <= gain <= 1.25
//
//   then the map of each channel over the picture (image/light_map.h)
//
// Three numbers hold no contact's shape, and what moves a marker or shades an eighth of the picture stops them: a held
// contact is never learned. At 60 Hz they follow 2.9 % a second. `is_off`: the light is not what the calibration saw and
// not yet followed: untouched by more than 4 %, else (half of the samples level) by more than 6 % over all channels,
// which no slope of the surface makes: it takes from one lamp what it gives to another; or a sixth of the samples is not
// level while the markers are at rest, as where part of a lamp fails.
//
// The level is what one frame alone says, for cameras that set their white or exposure anew under every touch: mean of
// the samples within 8 % of it in all three channels, three rounds from the medians on. The calibration says whether
// it counts (`photometric.balance`): a contact that shades most of the picture would move it.
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

using LightLevel = std::array<int32_t, 3>;  // relative change of B, G and R that a frame's light makes, Q16

class LightTracker {
 public:
  LightTracker(int width_px, int height_px);

  // A new rest image is in force: selects the usable samples. Without a map only the gain is followed, for boards that
  // do not turn colours into depth: on these a tray that tilts under a load looks like lamps that drift.
  void learn(std::span<const uint16_t> rest, bool has_map);
  // `change`: planes of B, G and R against `rest`, whose gain this sets when it has moved by 1/4096, and its map.
  void run(std::span<const RelativeChange> change, std::span<const Marker> markers, Rest& rest);

  [[nodiscard]] bool is_off() const { return is_off_ || map_.is_off(); }
  [[nodiscard]] const LightMap& map() const { return map_; }
  // An eighth of the samples are brighter by more than this in all three channels, beyond `level`. Where lamps of three colours stand
  // apart, no slope of the surface does that: it takes from one what it gives to another.
  // 2.5 %: a large object on a real pad does that to 1 sample in 17, presses on the twin to 1 in 100.
  static constexpr int kDaylightQ12 = 102;
  static constexpr int kTiltedQ12 = 328;  // 8 %: what carries the pad may come nearer to all lamps
  [[nodiscard]] bool is_lit_from_outside(int more_q12, const LightLevel& level) const;
  // The median of the samples in one outer third of the picture is above that in the opposite one by more than 2 % in all
  // three channels. No contact does that that leaves half of each third alone (presses on the twin 0.9 %, recorded ones
  // on a real pad 0.7 %), and no camera that sets its white. Not for skins that darken with depth.
  static constexpr int kSideQ12 = 82;
  [[nodiscard]] bool is_lit_from_one_side();
  // Of the last frame; unsure where fewer than an eighth of the samples agree, or by more than 25 %.
  [[nodiscard]] const LightLevel& level() const { return level_; }
  [[nodiscard]] bool level_is_sure() const { return level_is_sure_; }
  [[nodiscard]] const Rest::Gain& gain() const { return gain_; }

 private:
  struct Level {
    int median = 0;      // Q12
    size_t n_level = 0;  // samples near it
  };
  enum Side : uint8_t { kLeft = 1, kRight = 2, kTop = 4, kBottom = 8 };
  [[nodiscard]] std::optional<int> median_of(size_t channel, Side side);
  [[nodiscard]] bool is_brighter(Side one, Side other);
  void sample(std::span<const RelativeChange> change);
  [[nodiscard]] Level level_of(size_t channel);
  void measure(const std::array<Level, 3>& start);
  void follow(const std::array<Level, 3>& level);

  int width_px_;
  int height_px_;
  std::vector<int32_t> sample_at_;              // first pixel of each usable sample
  std::vector<uint8_t> side_;                   // outer thirds that each is in: sum of Side
  std::array<std::vector<int16_t>, 3> sample_;  // per channel
  std::vector<int16_t> sorted_;
  size_t n_samples_ = 0;
  LightLevel level_{};
  bool level_is_sure_ = false;
  int n_still_ = 0;  // frames in a row
  bool is_off_ = false;
  Rest::Gain gain_;
  Rest::Gain in_force_;
  LightMap map_;
};

}  // namespace ruffini
