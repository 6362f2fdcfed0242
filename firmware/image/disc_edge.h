// Measures centre and area of a dark disc whose centre is roughly known, from the points where rays cross its edge.
//
//   smooth   (1 4 6 4 1) / 16 along x, then along y, half up each, around the disc; the border is repeated
//   ray      mean grey at its dark end (three pixels from r - far outwards) and its bright end (three from r + far
//            inwards). No edge unless dark is below half of bright; else the first crossing of their mean between r -
//            near and r + near, in steps of 1/2 px, bilinear in the picture, linear between the steps
//   centre   start + (2 / n) sum r (cos, sin);   area  (pi / n) sum r^2     exact for a circle, from any inner point
//
// Two passes: 32 rays from the expected centre, then 128 rays from the result. Each ray has its own threshold, so a
// dent or a lamp beside the disc moves no edge. A ray that leaves the picture or finds no edge takes the mean of the
// others; with fewer than 3/4 of the rays the disc is not seen. Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace ruffini {

struct DiscMeasurement {
  int64_t x_q16 = 0;  // px
  int64_t y_q16 = 0;
  int64_t radius_q12 = 0;  // px, mean of the rays
  int64_t area_q8 = 0;     // px^2
  int64_t bright_q8 = 0;   // grey (image/difference.h) at the bright ends, mean
  bool is_seen = false;
};

class DiscEdge {
 public:
  static constexpr int kMinRadiusPx = 16;  // keeps a ray's dark end inside the disc
  static constexpr int kMaxRadiusPx = 200;

  // For discs of about this radius, in pictures of this size.
  DiscEdge(int width_px, int height_px, int radius_px);

  // Measures the disc near `about`. Precondition: `about` is in the picture.
  [[nodiscard]] DiscMeasurement locate(std::span<const uint16_t> grey, const DiscMeasurement& about);

 private:
  static constexpr size_t kRays = 128;
  // One pass: uses every n-th ray; reach of its ends and of its search around the expected radius, px.
  struct Turn {
    size_t every = 1;
    int far_px = 0;
    int near_px = 0;
  };
  struct Edge {
    int64_t r_q12 = -1;  // negative: none
    int64_t bright = 0;
  };

  void smooth(std::span<const uint16_t> grey, int middle_x, int middle_y);
  [[nodiscard]] DiscMeasurement measure(const DiscMeasurement& from, const Turn& turn) const;
  [[nodiscard]] Edge edge(const DiscMeasurement& from, const Turn& turn, size_t ray) const;
  [[nodiscard]] int64_t sample(const DiscMeasurement& from, size_t ray, int64_t r_q12) const;
  [[nodiscard]] bool is_inside(const DiscMeasurement& from, size_t ray, int64_t r_q12) const;

  int width_px_;
  int height_px_;
  int side_px_;      // side of the patch
  int left_px_ = 0;  // its position
  int top_px_ = 0;
  std::vector<uint16_t> row_;    // one row of the picture, with repeated borders
  std::vector<uint16_t> along_;  // smoothed along x
  std::vector<uint16_t> patch_;
  std::array<std::array<int32_t, 2>, kRays> direction_q14_{};
};

}  // namespace ruffini
