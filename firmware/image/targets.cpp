#include "image/targets.h"

#include <algorithm>
#include <cstdlib>

namespace ruffini {
namespace {

constexpr int kCoarsePx = 4;
// Coarse pixel i is the mean of pixels 4 i to 4 i + 3.
constexpr int64_t kCoarseMiddleQ16 = 3 * 65'536 / 2;

// Converts a length in the plane of the targets to pixels: f / (distance from the pinhole).
int64_t length_q16(const BoardSettings& board, int64_t um) {
  const int64_t distance_um = board.camera.standoff_um - board.targets.below_um;
  return floor_div(um * board.camera.focal_mpx * 65'536, distance_um * 1'000);
}

int radius_px(const BoardSettings& board) {
  return static_cast<int>(std::clamp<int64_t>(length_q16(board, board.targets.diameter_um) >> 17,
                                              DiscEdge::kMinRadiusPx, DiscEdge::kMaxRadiusPx));
}

// A box with sides of four radii: the target fills a fifth of it.
DotParameters spot_parameters(const BoardSettings& board) {
  const int radius = radius_px(board);
  const int area = radius * radius * 201 / (64 * kCoarsePx * kCoarsePx);  // pi r^2 in coarse pixels, pi = 201 / 64
  return {.width_px = board.camera.width_px / kCoarsePx,
          .height_px = board.camera.height_px / kCoarsePx,
          .box_radius_px = 2 * radius / kCoarsePx,
          .threshold_1e3 = static_cast<int>(board.targets.threshold_1e3),
          .polarity = Polarity::kDark,
          .min_area_px = area / 3,
          .max_area_px = 3 * area};
}

std::vector<DiscMeasurement> places_of(const BoardSettings& board) {
  std::vector<DiscMeasurement> out;
  const auto center_q16 = [](int64_t mpx) { return floor_div(mpx * 65'536 + 500, 1'000); };
  for (const PadPlace& at : board.targets.places) {
    out.push_back(
        {.x_q16 = center_q16(board.camera.center_x_mpx) + (length_q16(board, 2 * at.x_um - board.pad.size_x_um) >> 1),
         .y_q16 = center_q16(board.camera.center_y_mpx) + (length_q16(board, 2 * at.y_um - board.pad.size_y_um) >> 1),
         .radius_q12 = length_q16(board, board.targets.diameter_um) >> 5});
  }
  return out;
}

}  // namespace

TargetTracker::TargetTracker(const BoardSettings& board)
    : width_px_(board.camera.width_px),
      coarse_size_{board.camera.width_px / kCoarsePx, board.camera.height_px / kCoarsePx},
      places_(places_of(board)),
      targets_(places_.size()),
      coarse_(static_cast<size_t>(coarse_size_.count())),
      spots_(spot_parameters(board)),
      edge_(board.camera.width_px, board.camera.height_px, radius_px(board)) {}

void TargetTracker::find_spots(std::span<const uint16_t> grey) {
  uint16_t* out = coarse_.data();
  for (int y = 0; y < coarse_size_.n_y; ++y) {
    const uint16_t* row = grey.data() + ptrdiff_t{kCoarsePx} * y * width_px_;
    for (int x = 0; x < coarse_size_.n_x; ++x, row += kCoarsePx) {
      uint32_t sum = kCoarsePx * kCoarsePx / 2;
      for (int v = 0; v < kCoarsePx; ++v) {
        for (int u = 0; u < kCoarsePx; ++u) sum += row[ptrdiff_t{v} * width_px_ + u];
      }
      *out++ = static_cast<uint16_t>(sum / (kCoarsePx * kCoarsePx));
    }
  }
  found_ = spots_.detect(coarse_);
}

// Measures from the spot nearest to the expected position, within the target's radius.
DiscMeasurement TargetTracker::measure(std::span<const uint16_t> grey, const DiscMeasurement& expected) {
  DiscMeasurement about = expected;
  about.is_seen = false;
  int64_t least = (expected.radius_q12 << 4) * (expected.radius_q12 << 4);
  for (const Dot& spot : found_) {
    const int64_t x = int64_t{kCoarsePx} * spot.x.raw() + kCoarseMiddleQ16;
    const int64_t y = int64_t{kCoarsePx} * spot.y.raw() + kCoarseMiddleQ16;
    const int64_t dx = x - expected.x_q16;
    const int64_t dy = y - expected.y_q16;
    if (std::max(std::abs(dx), std::abs(dy)) > (expected.radius_q12 << 4)) continue;
    if (dx * dx + dy * dy >= least) continue;
    least = dx * dx + dy * dy;
    about.x_q16 = x;
    about.y_q16 = y;
    about.is_seen = true;
  }
  return about.is_seen ? edge_.locate(grey, about) : about;
}

int TargetTracker::learn(std::span<const uint16_t> grey) {
  find_spots(grey);
  int n = 0;
  for (size_t i = 0; i < places_.size(); ++i) {
    Target& t = targets_[i];
    t.rest = t.now = measure(grey, places_[i]);
    t.is_lost = !t.rest.is_seen;
    n += t.is_lost ? 0 : 1;
  }
  return n;
}

int TargetTracker::track(std::span<const uint16_t> grey) {
  find_spots(grey);
  int n_lost = 0;
  for (Target& t : targets_) {
    const DiscMeasurement now = t.rest.is_seen ? measure(grey, t.rest) : DiscMeasurement{};
    t.is_lost = !now.is_seen;
    if (now.is_seen) t.now = now;
    n_lost += t.is_lost ? 1 : 0;
  }
  return n_lost;
}

bool TargetTracker::is_light_wrong() const {
  int n_seen = 0;
  int n_off = 0;
  for (const Target& t : targets_) {
    if (t.is_lost) continue;
    ++n_seen;
    n_off += 4 * std::abs(t.now.bright_q8 - t.rest.bright_q8) > t.rest.bright_q8 ? 1 : 0;
  }
  return n_off > 0 && 2 * n_off >= n_seen;
}

}  // namespace ruffini
