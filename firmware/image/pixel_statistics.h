// Whether grey levels still mean what they meant at rest: for live cameras.
//
//   windows of 4 x 2 pixels, kWindows of them, drawn once
//   ties    share of the pairs of pixels side by side whose levels are equal, of all channels, where neither black nor white
//   d       = mean of a window over that of rest, less 1 and the gain that is followed (image/light.h); of windows
//           without edges, per channel; medians of the darker and of the brighter third by their level at rest
//
//   coarse      ties > 1.2 ties of the rest frames + 0.01: noise is gone, so bits were lost, or the picture was compressed
//   off curve   (dark + bright) / 2 is off by more than 0.8 % the same way in all channels, and bright - dark is against it by
//               more than a tenth: an offset (black level, daylight everywhere) or a gamma. Lamps and exposure change all levels
//               by the same share
//
// On the twin, presses change ties by 5 % of them, and 0.8 % is never reached in all channels. What d is of rest frames
// that were compressed already is not known. Ties are compared where rest was learned from this camera's frames; levels
// where each third has kFewest windows, 1.2 apart in level.
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
  struct Verdict {
    bool is_coarse = false;
    bool is_off_curve = false;
  };

  PixelStatistics(int width_px, int height_px);

  // Rest is learned from frames, from here on; then each of them.
  void begin_rest() { rest_ties_ = {}; }
  void add_rest(const FrameView& frame);
  // A new rest image, width x height x 3 in 1/16 grey levels.
  void learn(std::span<const uint16_t> rest);
  // `gain`: of rest, as it is followed. Precondition: learn() was called.
  [[nodiscard]] Verdict run(const FrameView& frame, const Rest::Gain& gain);

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
  [[nodiscard]] bool is_off_curve(const Rest::Gain& gain);
  [[nodiscard]] int32_t median(std::span<const Level> levels, size_t channel);

  int width_px_;
  std::vector<Window> windows_;
  std::vector<std::array<int32_t, 3>> sum_;   // of now, grey levels of 8 pixels
  std::array<std::vector<Level>, 3> levels_;  // per channel, dark ones first
  std::vector<int32_t> sorted_;
  bool has_levels_ = false;
  Ties rest_ties_;
};

}  // namespace ruffini
