#include "image/block_edges.h"

#include <algorithm>
#include <cstddef>
#include <cstdlib>

namespace ruffini {
namespace {

constexpr int kBlock = 8;
constexpr ptrdiff_t kChannels = 3;
constexpr int kUnlimited = 8 * 255;
constexpr int64_t kRatioPercent = 120;

// Roughness between the pixel at `at` and the one before it, over all channels.
int step(const uint8_t* at, int most) {
  int sum = 0;
  for (ptrdiff_t c = 0; c < kChannels; ++c) {
    const int rough = at[c - 2 * kChannels] - at[c + kChannels] + 3 * (at[c] - at[c - kChannels]);
    sum += std::min(std::abs(rough), most);
  }
  return sum;
}

}  // namespace

BlockEdges::BlockEdges(int width_px, int height_px) {
  if (width_px < kMinColumns || height_px < kRows) return;
  n_blocks_ = (width_px - 2) / kBlock;
  for (int i = 0; i < kRows; ++i) row_[static_cast<size_t>(i)] = (2 * i + 1) * height_px / (2 * kRows);
}

void BlockEdges::add(const FrameView& frame, int max_step, Sums& sums) const {
  for (size_t i = 0; i < row_.size() && n_blocks_ > 0; ++i) {
    const uint8_t* block = frame.row(row_[i]);
    int at_edges = 0;
    int in_middles = 0;
    for (int k = 0; k < n_blocks_; ++k, block += kBlock * kChannels) {
      in_middles += step(block + kBlock / 2 * kChannels, max_step);
      at_edges += step(block + kBlock * kChannels, max_step);
    }
    sums.at_edges += at_edges;
    sums.in_middles += in_middles;
  }
}

void BlockEdges::add_rest(const FrameView& frame) {
  if (n_blocks_ == 0) return;
  if (rest_.at_edges == 0 && rest_.in_middles == 0) {
    Sums all;
    add(frame, kUnlimited, all);
    max_step_ = static_cast<int>((all.at_edges + all.in_middles) / (kChannels * kRows * n_blocks_));
  }
  add(frame, max_step_, rest_);
}

bool BlockEdges::run(const FrameView& frame) {
  Sums now;
  add(frame, max_step_, now);
  return 100 * now.at_edges * rest_.in_middles > kRatioPercent * rest_.at_edges * now.in_middles;
}

}  // namespace ruffini
