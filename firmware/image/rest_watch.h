// What is known of rest beside its picture.
#pragma once

#include <cstdint>

namespace ruffini {

struct RestWatch {
  bool is_watched = true;      // what is learned is compared with the rest of before, frame by frame
  uint32_t flags_before = 0;   // FlagBits of the last frame before the learning
  bool is_asked = false;       // somebody zeroed, and did not just start the sensor
  bool is_expected = false;    // a start that is compared: FramePath::expect_rest()
  bool is_seen = false;        // each frame of the learning could be compared
  bool is_unverified = false;  // kFlagRestUnverified
  bool is_of_before = false;   // a start was refused: rest is that of the run before, until a zero
  int n_untouched = 0;         // frames in a row that show an untouched pad, while rest is of before and unverified
  uint32_t n_refused = 0;      // how often a watched learning ended because something pressed
  uint32_t n_known = 0;  // how often rest was learned while nothing pressed that could be seen, or as somebody asked
};

}  // namespace ruffini
