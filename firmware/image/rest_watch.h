// State of the rest image beside its pixels.
#pragma once

#include <cstdint>

namespace ruffini {

struct RestWatch {
  bool is_watched = true;         // while learning, each frame is compared with the previous rest image
  uint32_t flags_before = 0;      // FlagBits of the last frame before the learning
  bool is_requested = false;      // the user requested a zero, as opposed to a start
  bool is_start_checked = false;  // the start is compared with the previous run: FramePath::expect_rest()
  bool is_comparable = false;     // every frame of the learning could be compared
  bool is_unverified = false;     // kFlagRestUnverified
  bool is_from_last_run = false;  // a start was refused: the rest image of the previous run is used until a zero
  // Consecutive frames of an untouched pad, while the rest image is from the previous run and unverified
  int n_untouched = 0;
  uint32_t n_refused = 0;   // number of learnings that ended because something pressed
  uint32_t n_accepted = 0;  // number of rest images learned without visible contact, or by request
};

}  // namespace ruffini
