// A touch of a skin that gets brighter where it is pressed: what its estimators say, in the order of force.
//
// The skin is unrolled: x and y along the undeformed surface from its middle. Only the force along the local normal is
// measured; a frame has at most kMax touches listed.
#pragma once

#include <array>
#include <cstdint>

namespace ruffini {

struct SkinTouch {
  uint32_t id = 0;  // the same from frame to frame (skin_track.h); 0: not known yet
  int64_t x_um = 0;
  int64_t y_um = 0;
  int64_t area_um2 = 0;        // of the taxels that it lights up; 0: not known
  int64_t brightness_q2 = 0;   // 1/4 levels of the weighted channels; of taxels 1/4096 of rest
  int64_t press_un = 0;        // into the skin
  int64_t press_sigma_un = 0;  // standard deviations; 0: not stated
  int64_t place_sigma_um = 0;  // of x and of y
};

struct SkinTouchList {
  static constexpr int kMax = 8;
  std::array<SkinTouch, kMax> touch{};
  int n_listed = 0;
  int n_found = 0;
};

}  // namespace ruffini
