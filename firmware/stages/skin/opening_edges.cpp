#include "stages/skin/opening_edges.h"

#include <algorithm>
#include <bit>
#include <cstdlib>
#include <utility>

#include "base/fixed.h"
#include "solve/node_sigma.h"

namespace ruffini {
namespace {

constexpr int kBlock = 8;
constexpr int kCell = 64;
constexpr int64_t kMinGradient = 32;  // quarter levels per pixel
constexpr size_t kMinSamples = 64;
constexpr int kMinInCell = 4;
constexpr size_t kMinCells = 24;
constexpr int kEntryBits = 28;    // of a sector's sums, so that products of two fit
constexpr int64_t kPerPixel = 5;  // 1 / 0.2 px
constexpr int64_t kOffQ12 = 33;   // 0.8 %
constexpr int64_t kOneQ12 = 4096;

enum SectorName : uint32_t { kRight, kLeft, kBelow, kAbove };

}  // namespace

OpeningEdges::OpeningEdges(const CameraSettings& camera)
    : camera_(camera), n_cells_x_((camera.width_px + kCell - 1) / kCell) {
  const auto n_blocks = static_cast<size_t>((camera.width_px / kBlock) * (camera.height_px / kBlock));
  samples_.reserve(n_blocks);
  runs_.reserve(n_blocks);
  cells_.resize(static_cast<size_t>(n_cells_x_ * ((camera.height_px + kCell - 1) / kCell)));
  sorted_.reserve(cells_.size());
}

// Adds the pixel of the block that has the strongest gradient, the first one in row order.
void OpeningEdges::add_block(std::span<const int16_t> base, int left, int top) {
  const int width = camera_.width_px;
  Sample best;
  int64_t most = 4 * kMinGradient * kMinGradient;
  for (int y = std::max(top, 1); y < std::min(top + kBlock, camera_.height_px - 1); ++y) {
    for (int x = std::max(left, 1); x < std::min(left + kBlock, width - 1); ++x) {
      const auto at = static_cast<size_t>(y * width + x);
      const int32_t twice_x = base[at + 1] - base[at - 1];
      const int32_t twice_y = base[at + static_cast<size_t>(width)] - base[at - static_cast<size_t>(width)];
      const int64_t square = int64_t{twice_x} * twice_x + int64_t{twice_y} * twice_y;
      if (square <= most) continue;
      most = square;
      const int64_t aside = 1'000 * int64_t{x} - camera_.center_x_mpx;
      const int64_t down = 1'000 * int64_t{y} - camera_.center_y_mpx;
      const bool is_beside = std::abs(aside) >= std::abs(down);
      best = {.pixel = static_cast<uint32_t>(at),
              .base = base[at],
              .twice_x = twice_x,
              .twice_y = twice_y,
              .limit = static_cast<int32_t>(floor_sqrt(square) / 2),
              .sector = is_beside ? (aside > 0 ? kRight : kLeft) : (down > 0 ? kBelow : kAbove),
              .cell = static_cast<uint32_t>((y / kCell) * n_cells_x_ + x / kCell)};
    }
  }
  if (best.limit > 0) samples_.push_back(best);
}

void OpeningEdges::learn(std::span<const int16_t> base) {
  samples_.clear();
  for (int top = 0; top + kBlock <= camera_.height_px; top += kBlock) {
    for (int left = 0; left + kBlock <= camera_.width_px; left += kBlock) add_block(base, left, top);
  }
  // The sums of run() do not depend on the order; of one cell in one sector they stay in registers.
  const auto place = [](const Sample& s) { return std::pair(s.sector, s.cell); };
  std::sort(samples_.begin(), samples_.end(), [&](const Sample& a, const Sample& b) { return place(a) < place(b); });
  runs_.clear();
  for (uint32_t i = 0; i < samples_.size(); ++i) {
    if (i == 0 || place(samples_[i - 1]) != place(samples_[i])) runs_.push_back({.first = i});
    runs_.back().end = i + 1;
  }
  std::array<size_t, kSectors> n_samples{};
  std::vector<int> n_in_cell(cells_.size());
  sectors_ = {};
  std::fill(cells_.begin(), cells_.end(), Cell{});
  for (const Sample& s : samples_) {
    Sector& sector = sectors_[s.sector];
    sector.xx += int64_t{s.twice_x} * s.twice_x;
    sector.xy += int64_t{s.twice_x} * s.twice_y;
    sector.yy += int64_t{s.twice_y} * s.twice_y;
    ++n_samples[s.sector];
    cells_[s.cell].base += s.base;
    ++n_in_cell[s.cell];
  }
  for (size_t i = 0; i < cells_.size(); ++i) {
    if (n_in_cell[i] < kMinInCell) cells_[i].base = 0;
  }
  for (size_t i = 0; i < kSectors; ++i) {
    Sector& s = sectors_[i];
    s.shift = std::max(0, static_cast<int>(std::bit_width(static_cast<uint64_t>(s.xx + s.yy))) - kEntryBits);
    for (int64_t* sum : {&s.xx, &s.xy, &s.yy}) *sum >>= s.shift;
    const int64_t trace = s.xx + s.yy;
    s.is_known = n_samples[i] >= kMinSamples && 16 * (s.xx * s.yy - s.xy * s.xy) > trace * trace;
  }
}

OpeningEdges::Defects OpeningEdges::run(std::span<const int16_t> glow, int64_t light_q12) {
  std::array<std::array<int64_t, 2>, kSectors> moment{};  // sum of 2 g r
  for (Cell& cell : cells_) cell.glow = 0;
  for (const Run& run : runs_) {
    int64_t x = 0;
    int64_t y = 0;
    int64_t sum = 0;
    for (const Sample& s : std::span(samples_).subspan(run.first, run.end - run.first)) {
      const int64_t seen = glow[s.pixel];
      const int64_t r = std::clamp<int64_t>((light_q12 * s.base >> 12) - seen, -s.limit, s.limit);
      x += r * s.twice_x;
      y += r * s.twice_y;
      sum += seen;
    }
    const Sample& first = samples_[run.first];
    moment[first.sector][0] += x;
    moment[first.sector][1] += y;
    cells_[first.cell].glow += sum;
  }
  Defects found;
  for (size_t i = 0; i < kSectors; ++i) {
    const Sector& s = sectors_[i];
    if (!s.is_known) continue;
    const int64_t x = moment[i][0] >> s.shift;
    const int64_t y = moment[i][1] >> s.shift;
    // d = 2 (x', y') / det
    const int64_t furthest = std::max(std::abs(s.yy * x - s.xy * y), std::abs(s.xx * y - s.xy * x));
    found.has_moved |= 2 * kPerPixel * furthest > s.xx * s.yy - s.xy * s.xy;
  }
  sorted_.clear();
  for (const Cell& cell : cells_) {
    if (cell.base > 0) sorted_.push_back(static_cast<int32_t>(floor_div(kOneQ12 * cell.glow, cell.base)));
  }
  if (sorted_.size() < kMinCells) return found;
  const auto middle = sorted_.begin() + static_cast<ptrdiff_t>(sorted_.size() / 2);
  std::nth_element(sorted_.begin(), middle, sorted_.end());
  found.is_off_curve = std::abs(*middle - light_q12) > kOffQ12;
  return found;
}

}  // namespace ruffini
