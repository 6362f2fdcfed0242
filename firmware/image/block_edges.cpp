#include "image/block_edges.h"

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdlib>
#include <cstring>

namespace ruffini {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr int kBlock = 8;
constexpr ptrdiff_t kChannels = 3;
constexpr int kUnlimited = 8 * 255;
constexpr int64_t kRatioPercent = 120;

// Two pixels side by side: the one in the middle of a block and the one at its end, each with a byte that is ignored.
// GCC and clang have such types for every target.
using Pixels __attribute__((vector_size(16))) = uint32_t;
using Bytes __attribute__((vector_size(16))) = uint8_t;
using Lanes __attribute__((vector_size(16))) = int16_t;
constexpr int kSumBlocks = 16;  // blocks whose roughness a lane can hold: 16 kUnlimited < 2^15

Lanes load(const uint8_t* block, ptrdiff_t pixel) {
  uint32_t middle = 0;
  uint32_t end = 0;
  std::memcpy(&middle, block + (kBlock / 2 + pixel) * kChannels, sizeof(middle));
  std::memcpy(&end, block + (kBlock + pixel) * kChannels, sizeof(end));
  const auto bytes = reinterpret_cast<Bytes>(Pixels{middle, end, 0, 0});
  return reinterpret_cast<Lanes>(
      __builtin_shufflevector(bytes, Bytes{}, 0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23));
}

// Roughness before both pixels of a block, by channel. Reads a byte beyond them and their neighbours.
Lanes steps(const uint8_t* block, Lanes most) {
  const Lanes rough = load(block, -2) - load(block, 1) + 3 * (load(block, 0) - load(block, -1));
  const Lanes size = rough > -rough ? rough : -rough;
  return size < most ? size : most;
}

// Roughness before one pixel, over all channels.
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
  const int n_all = (width_px - 2) / kBlock;
  stride_ = (n_all + kMaxBlocks - 1) / kMaxBlocks;
  n_blocks_ = n_all / stride_;
  for (int i = 0; i < kRows; ++i) row_[static_cast<size_t>(i)] = (2 * i + 1) * height_px / (2 * kRows);
}

void BlockEdges::add(const FrameView& frame, int max_step, Sums& sums) const {
  const Lanes most = Lanes{} + static_cast<int16_t>(max_step);
  const ptrdiff_t to_next = stride_ * kBlock * kChannels;
  for (size_t i = 0; i < row_.size() && n_blocks_ > 0; ++i) {
    const uint8_t* block = frame.row(row_[i]);
    int at_edges = 0;
    int in_middles = 0;
    // The last block has no byte beyond it.
    for (int k = 0; k < n_blocks_ - 1;) {
      Lanes sum{};
      for (const int end = std::min(k + kSumBlocks, n_blocks_ - 1); k < end; ++k, block += to_next) {
        sum += steps(block, most);
      }
      in_middles += sum[0] + sum[1] + sum[2];
      at_edges += sum[4] + sum[5] + sum[6];
    }
    in_middles += step(block + kBlock / 2 * kChannels, max_step);
    at_edges += step(block + kBlock * kChannels, max_step);
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
