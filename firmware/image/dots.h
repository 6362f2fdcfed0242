// Printed dots in a grey image: sub-pixel centres of spots darker (or lighter) than their surroundings.
//
//   background = box sum / box area, box of radius r clipped at the border, rounded down
//   v = background - grey (dark dots) or grey - background (light ones)
//   weight = v - background threshold / 1000, where positive
//   centre = sum(weight position) / sum(weight) over a 4-connected component, Q16, rounded down
//
// The weight falls to zero at the component's edge, so the centre has no jumps as the dot moves over
// the pixel grid. Components that touch the border, or whose area is outside [min, max], are dropped.
// Grey is B + G + R in 1/16 levels. Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"

namespace ruffini {

struct Dot {
  ImagePx x;
  ImagePx y;
  int area_px = 0;
};

struct DotParameters {
  int width_px = 0;
  int height_px = 0;
  int box_radius_px = 0;
  int threshold_1e3 = 0;
  Polarity polarity = Polarity::kDark;
  int min_area_px = 0;
  int max_area_px = 0;
};

class DotDetector {
 public:
  static constexpr int kMaxDots = 4096;

  explicit DotDetector(const DotParameters& parameters);

  // Dots of `grey` (width x height) in order of their first pixel; valid until the next call.
  std::span<const Dot> detect(std::span<const uint16_t> grey);

 private:
  // Moments of one component; a child points to its parent after a union.
  struct Component {
    int parent = 0;
    int area = 0;
    bool touches_border = false;
    int64_t weight = 0;
    int64_t weight_x = 0;
    int64_t weight_y = 0;
  };

  void weigh_row(std::span<const uint16_t> grey, int y);
  void move_box(std::span<const uint16_t> grey, int y);
  int find(int component);
  int join(int a, int b);

  DotParameters p_;
  std::vector<int64_t> column_sum_;  // grey over the rows of the box
  std::vector<int64_t> prefix_sum_;  // of column_sum_, width + 1
  std::vector<int32_t> weight_;      // of the current row
  std::vector<int32_t> label_;       // of the row above, overwritten by the current one; -1 = none
  std::vector<Component> components_;
  int n_components_ = 0;
  std::vector<Dot> dots_;
};

}  // namespace ruffini
