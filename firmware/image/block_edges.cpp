#include "image/block_edges.h"

#include <algorithm>
#include <cstdlib>

namespace ruffini {
namespace {

constexpr size_t kBlock = 8;
constexpr size_t kChannels = 3;
constexpr int kMostStep = 24;
constexpr int64_t kRatioPercent = 120;
static_assert(BlockEdges::kRows * kMostStep <= UINT16_MAX);

}  // namespace

BlockEdges::BlockEdges(int width_px, int height_px) {
  if (width_px < kLeastColumns || height_px < kRows) return;
  step_.resize(kChannels * static_cast<size_t>(width_px - 3));
  for (int i = 0; i < kRows; ++i) row_[static_cast<size_t>(i)] = (2 * i + 1) * height_px / (2 * kRows);
}

void BlockEdges::add(const FrameView& frame, Sums& sums) {
  std::fill(step_.begin(), step_.end(), uint16_t{0});
  if (step_.empty()) return;
  for (const int y : row_) {
    const uint8_t* at = frame.row(y);
    for (size_t i = 0; i < step_.size(); ++i) {
      const int rough = at[i] - 3 * at[i + kChannels] + 3 * at[i + 2 * kChannels] - at[i + 3 * kChannels];
      step_[i] = static_cast<uint16_t>(step_[i] + std::min(std::abs(rough), kMostStep));
    }
  }
  for (size_t i = 0; i < step_.size(); ++i) {
    ((i / kChannels + 2) % kBlock == 0 ? sums.at_edges : sums.elsewhere) += step_[i];
  }
}

bool BlockEdges::run(const FrameView& frame) {
  Sums now;
  add(frame, now);
  return 100 * now.at_edges * rest_.elsewhere > kRatioPercent * rest_.at_edges * now.elsewhere;
}

}  // namespace ruffini
