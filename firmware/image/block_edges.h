// Detects the edges of 8 x 8 blocks that compression (JPEG, MJPEG) leaves in a live camera's picture.
//
//   rough(x) = |I(x-2) - 3 I(x-1) + 3 I(x) - I(x+1)| per channel, in kRows rows: the roughness between pixels x-1 and x,
//              blind to slopes and bends
//   step(x) = min(rough(x), twice its mean in the first rest frame), so that the few strong edges of markers and of a sharp
//             contact weigh no more than noise
//   ratio   = sum of the steps at the blocks' edges, x = 8, 16, ... / sum of those in their middles, x = 4, 12, ...
//   blocks    ratio > 1.2 ratio of the rest frames
//
// Compared with the ratio at rest, pressed pads of the twins, flat faces with sharp rims included, reach 1.06, recordings 1.12,
// and JPEG of quality 65 has at least 1.26. Pictures that were compressed when rest was learned are compared with such.
// Limits: blocks whose first column is elsewhere; fewer than kRows rows or kLeastColumns columns.
// Frame thread; no allocation. Not in the papers.
#pragma once

#include <array>
#include <cstdint>

#include "base/image_view.h"

namespace ruffini {

class BlockEdges {
 public:
  static constexpr int kRows = 16;
  static constexpr int kLeastColumns = 128;  // of fewer blocks a mark that moves changes the ratio

  BlockEdges(int width_px, int height_px);

  // Starts a new rest image; add_rest() takes each of its frames.
  void begin_rest() { rest_ = {}; }
  void add_rest(const FrameView& frame);
  // True if the picture has blocks that the rest frames did not have. Never without rest frames.
  [[nodiscard]] bool run(const FrameView& frame);

 private:
  struct Sums {
    int64_t at_edges = 0;
    int64_t in_middles = 0;
  };
  void add(const FrameView& frame, int most_step, Sums& sums) const;

  int n_blocks_ = 0;  // along x, whose middle and right edge are looked at
  std::array<int, kRows> row_{};
  int most_step_ = 0;
  Sums rest_;
};

}  // namespace ruffini
