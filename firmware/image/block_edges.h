// Detects the edges of 8 x 8 blocks that compression (JPEG, MJPEG) leaves in a live camera's picture.
//
//   step(x) = min(|I(x-2) - 3 I(x-1) + 3 I(x) - I(x+1)|, kMostStep) per channel, in kRows rows: what is rough between
//             pixels x-1 and x, blind to slopes and bends
//   ratio   = sum of the steps at the blocks' edges, x = 8, 16, ... / sum of those in their middles, x = 4, 12, ...
//   blocks    ratio > 1.2 ratio of the rest frames
//
// On the twins the ratio is 1.0 to 1.4 at rest, within 3 % of that under presses, and 1.2 to 1.9 times that at JPEG
// qualities of 60 to 20. Pictures that were compressed when rest was learned are compared with such. Limits: blocks whose
// first column is elsewhere; fewer than kRows rows or kLeastColumns columns.
// Frame thread; no allocation. Not in the papers.
#pragma once

#include <array>
#include <cstdint>

#include "base/image_view.h"

namespace ruffini {

class BlockEdges {
 public:
  static constexpr int kRows = 8;
  static constexpr int kLeastColumns = 128;  // of fewer blocks a mark that moves changes the ratio

  BlockEdges(int width_px, int height_px);

  // Starts a new rest image; add_rest() takes each of its frames.
  void begin_rest() { rest_ = {}; }
  void add_rest(const FrameView& frame) { add(frame, rest_); }
  // True if the picture has blocks that the rest frames did not have. Never without rest frames.
  [[nodiscard]] bool run(const FrameView& frame);

 private:
  struct Sums {
    int64_t at_edges = 0;
    int64_t in_middles = 0;
  };
  void add(const FrameView& frame, Sums& sums) const;

  int n_blocks_ = 0;  // along x, whose middle and right edge are looked at
  std::array<int, kRows> row_{};
  Sums rest_;
};

}  // namespace ruffini
