// Detects the edges of 8 x 8 blocks that compression (JPEG, MJPEG) leaves in a live camera's picture.
//
//   rough(x) = |I(x-2) - 3 I(x-1) + 3 I(x) - I(x+1)| per channel, in kRows rows: the roughness between pixels x-1 and
//              x, zero for slopes and constant curvature
//   step(x) = min(rough(x), twice its mean in the first rest frame), so that the few strong edges of markers and of a
//             sharp contact count no more than noise
//   ratio   = sum of the steps at block edges, x = 8, 16, ... / sum of those at block centres, x = 4, 12, ...
//   blocks    ratio > 1.2 ratio of the rest frames
//
// Relative to the ratio at rest, pressed pads of the twins, including flat faces with sharp rims, reach 1.06,
// recordings 1.12, and JPEG of quality 65 at least 1.26. If the rest frames were compressed too, compressed frames are
// not detected. Limits: blocks that do not begin at column 0; pictures with fewer than kRows rows or kMinColumns
// columns. Frame thread; no allocation. Not in the papers.
#pragma once

#include <array>
#include <cstdint>

#include "base/image_view.h"

namespace ruffini {

class BlockEdges {
 public:
  static constexpr int kRows = 16;
  static constexpr int kMinColumns = 128;  // with fewer blocks a moving marker would change the ratio
  static constexpr int kMaxBlocks = 79;    // in a row; of wider pictures each second block, each third, ...

  BlockEdges(int width_px, int height_px);

  // Starts a new rest image; add_rest() takes each of its frames.
  void begin_rest() { rest_ = {}; }
  void add_rest(const FrameView& frame);
  // Returns true if the picture has block edges that the rest frames did not have. Always false without rest frames.
  [[nodiscard]] bool run(const FrameView& frame);

 private:
  struct Sums {
    int64_t at_edges = 0;
    int64_t in_middles = 0;
  };
  void add(const FrameView& frame, int max_step, Sums& sums) const;

  int n_blocks_ = 0;  // number of blocks along x whose centre and right edge are used
  int stride_ = 1;    // from each to the next
  std::array<int, kRows> row_{};
  int max_step_ = 0;
  Sums rest_;
};

}  // namespace ruffini
