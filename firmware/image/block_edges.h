// Detects the edges of 8 x 8 blocks that compression (JPEG, MJPEG) leaves in a live camera's picture.
//
//   step(x) = min(|I(x) - 3 I(x+1) + 3 I(x+2) - I(x+3)|, kMostStep) per channel, in kRows rows: what is rough between
//             pixels x+1 and x+2, blind to slopes and bends
//   ratio   = mean step over the blocks' edges (x + 2 divisible by 8) / mean step elsewhere
//   blocks    ratio > 1.2 ratio of the rest frames
//
// On the twins the ratio is 1.0 to 1.4 at rest, within 3 % of that under presses, and 1.2 to 1.9 times that at JPEG
// qualities of 60 to 20. Pictures that were compressed when rest was learned are compared with such. Limits: blocks whose
// first column is elsewhere; fewer than kRows rows or kLeastColumns columns.
// Frame thread; no allocation after the constructor. Not in the papers.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

class BlockEdges {
 public:
  static constexpr int kRows = 16;
  static constexpr int kLeastColumns = 24;

  BlockEdges(int width_px, int height_px);

  // Starts a new rest image; add_rest() takes each of its frames.
  void begin_rest() { rest_ = {}; }
  void add_rest(const FrameView& frame) { add(frame, rest_); }
  // True if the picture has blocks that the rest frames did not have. Never without rest frames.
  [[nodiscard]] bool run(const FrameView& frame);

 private:
  struct Sums {
    int64_t at_edges = 0;
    int64_t elsewhere = 0;
  };
  void add(const FrameView& frame, Sums& sums);

  std::vector<uint16_t> step_;  // of each place of a row, channels interleaved, over the rows
  std::array<int, kRows> row_{};
  Sums rest_;
};

}  // namespace ruffini
