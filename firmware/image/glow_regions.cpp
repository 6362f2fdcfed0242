#include "image/glow_regions.h"

#include <algorithm>

namespace ruffini {

GlowRegions::GlowRegions(const BoardSettings& board)
    : width_px_(board.camera.width_px),
      height_px_(board.camera.height_px),
      level_q2_(static_cast<int16_t>(4 * board.skin.level)),
      min_area_px_(static_cast<int>(board.skin.min_area_px)),
      blobs_(width_px_, height_px_),
      above_(blobs_.row()) {}

void GlowRegions::find(std::span<const int16_t> smoothed) {
  blobs_.start();
  peak_ = {0, 0, smoothed[0]};
  const auto width = static_cast<size_t>(width_px_);
  for (int y = 0; y < height_px_; ++y) {
    const int16_t* const row = smoothed.data() + static_cast<size_t>(y) * width;
    int16_t most = row[0];
    for (size_t x = 0; x < width; ++x) {
      most = std::max(most, row[x]);
      above_[x] = row[x] > level_q2_ ? row[x] : int16_t{0};
    }
    if (most > peak_.level_q2) peak_ = {static_cast<int>(std::find(row, row + width, most) - row), y, most};
    blobs_.add(above_, y);
  }
  n_listed_ = n_found_ = 0;
  for (size_t i = 0; i < blobs_.all().size(); ++i) {
    const Blob& blob = blobs_.all()[i];
    if (blob.parent != static_cast<int>(i) || blob.area < min_area_px_) continue;
    ++n_found_;
    list_by_area({ImagePx::from_raw(static_cast<int32_t>((blob.x << 16) / blob.area)),
                  ImagePx::from_raw(static_cast<int32_t>((blob.y << 16) / blob.area)), blob.area,
                  static_cast<int>(blob.weight / blob.area)});
  }
}

// Inserts the region sorted by area; of equal ones the first found comes first.
void GlowRegions::list_by_area(const GlowRegion& region) {
  int at = n_listed_;
  while (at > 0 && regions_[static_cast<size_t>(at - 1)].area_px < region.area_px) --at;
  if (at == kMax) return;
  n_listed_ = std::min(n_listed_ + 1, kMax);
  for (int i = n_listed_ - 1; i > at; --i) regions_[static_cast<size_t>(i)] = regions_[static_cast<size_t>(i - 1)];
  regions_[static_cast<size_t>(at)] = region;
}

}  // namespace ruffini
