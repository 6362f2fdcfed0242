// Finds where a glowing skin became brighter: the brightest pixel, and the connected regions above a level.
//
//   peak    largest smoothed brightness; the first one in row order
//   region  4-connected pixels above [skin] level, at least min_area_px of them: area, mean position, mean brightness
//
// As in the paper ("maximum intensity", "region growth", "centroid", "mean light intensity"), but the regions come from
// the smoothed picture too: noise tears no holes, and adjacent openings under one finger merge. Frame thread; no
// allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "image/blobs.h"

namespace ruffini {

struct GlowPeak {
  int x_px = 0;
  int y_px = 0;
  int level_q2 = 0;  // 1/4 levels
};

struct GlowRegion {
  ImagePx x;
  ImagePx y;
  int area_px = 0;
  int mean_q2 = 0;
};

class GlowRegions {
 public:
  static constexpr int kMax = 8;

  explicit GlowRegions(const BoardSettings& board);

  void find(std::span<const int16_t> smoothed);

  [[nodiscard]] const GlowPeak& peak() const { return peak_; }
  // Sorted by area, largest first.
  [[nodiscard]] std::span<const GlowRegion> regions() const {
    return {regions_.data(), static_cast<size_t>(n_listed_)};
  }
  [[nodiscard]] int n_found() const { return n_found_; }

 private:
  void list_by_area(const GlowRegion& region);

  int width_px_;
  int height_px_;
  int16_t level_q2_;
  int min_area_px_;
  Blobs blobs_;
  std::vector<int16_t> above_;  // one row: brightness above the level, else 0
  GlowPeak peak_;
  std::array<GlowRegion, kMax> regions_{};
  int n_listed_ = 0;
  int n_found_ = 0;
};

}  // namespace ruffini
