// Detects pixel values that a live camera codes differently than at rest: bits lost, compression, gamma, black level.
//
//   windows of 4 x 2 pixels, kWindows of them, drawn once
//   ties   share of horizontally adjacent pixel pairs with equal levels, over all channels, without black and white
//          ones
//   colour sum of |a_B - a_G| + |a_R - a_G| over the pairs; a: right pixel minus left one
//   d      (mean of a window) / (its mean at rest) - followed gain (image/light.h; not the map), per channel, of
//          windows
//          without edges
//   dark, bright   medians of d over the darker and the brighter third of the windows, by their level at rest
//
//   coarse      ties > 1.2 ties of the rest frames + 0.01: noise is missing, so bits were lost or the picture is
//               compressed;
//               or colour < 0.7 of the rest frames': noise of the colours is missing, as after JPEG
//   off curve   o = (dark + bright) / 2 is beyond 0.8 % with one sign in all channels, and dark parts changed more:
//               dark - bright, summed over the channels, has that sign and exceeds a tenth of the sum of |o|. An offset
//               (black level, daylight) or a gamma does this; lamps and exposure change all levels by the same share
//
// On the twins a press changes ties by at most 5 % of their value, lowers colour by at most 8 %, and never reaches
// 0.8 % in all channels; JPEG lowers colour to 0.23 to 0.68 on skins with coloured light, on grey ones only below a
// quality of 75.
// In recordings that were compressed from the start, presses lower it to 0.84. Limits: ties and colour need rest frames
// of this camera; levels need kFewest windows in each third and a ratio of 1.2 between the thirds.
// Frame thread; no allocation after the constructor but in learn(). Not in the papers.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "image/rest.h"

namespace ruffini {

class PixelStatistics {
 public:
  struct Defects {
    bool is_coarse = false;
    bool is_off_curve = false;
  };

  PixelStatistics(int width_px, int height_px);

  // Starts a new rest image; add_rest() takes each of its frames.
  void begin_rest() {
    rest_ties_ = {};
    rest_colour_ = n_rest_ = 0;
  }
  void add_rest(const FrameView& frame);
  // A new rest image, width x height x 3 in 1/16 grey levels.
  void learn(std::span<const uint16_t> rest);
  // `gain`: of rest, as it is followed. Precondition: learn() was called.
  [[nodiscard]] Defects run(const FrameView& frame, const Rest::Gain& gain);

 private:
  struct Window {
    int32_t x = 0;
    int32_t y = 0;
  };
  struct Ties {
    int64_t n_equal = 0;
    int64_t n = 0;
  };
  struct Level {
    int32_t rest = 0;  // sum of 8 pixels, 1/16 grey levels
    int32_t reciprocal_q24 = 0;
    int32_t window = 0;
  };
  void add_window(const FrameView& frame, size_t window, Ties& ties);
  [[nodiscard]] int64_t colour_of(const FrameView& frame) const;
  [[nodiscard]] bool is_coarse(const Ties& now, int64_t colour) const;
  [[nodiscard]] bool is_off_curve(const Rest::Gain& gain);
  [[nodiscard]] int32_t median(std::span<const Level> levels, size_t channel);

  int width_px_;
  std::vector<Window> windows_;
  std::vector<std::array<int32_t, 3>> sum_;   // of now, grey levels of 8 pixels
  std::array<std::vector<Level>, 3> levels_;  // per channel, dark ones first
  std::vector<int32_t> sorted_;
  bool has_levels_ = false;
  Ties rest_ties_;
  int64_t rest_colour_ = 0;  // of n_rest_ frames
  int64_t n_rest_ = 0;
};

}  // namespace ruffini
