// Centre and area of a dark disc whose middle is roughly known, from where rays out of it cross its edge.
//
//   smooth   (1 4 6 4 1) / 16 along x, then along y, half up each, round the disc; what is beyond the border repeats it
//   ray      grey at its dark end (three pixels from r - far outwards) and its bright end (three from r + far inwards):
//            no edge where dark is not below half of bright; else where grey first crosses their mean, from r - near to
//            r + near in steps of 1/2 px, bilinear in the picture, linear between the steps
//   centre   middle + (2 / n) sum r (cos, sin);   area  (pi / n) sum r^2     exact for a circle, seen from any point in it
//
// Two turns: 32 rays from where the disc is thought to be, 128 from where those put it. The level belongs to the ray: a
// dent or a lamp beside the disc moves no edge. A ray that leaves the picture or shows no edge takes the mean of the others;
// with fewer than 3/4 of the rays the disc is not seen. Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace ruffini {

struct DiscSight {
  int64_t x_q16 = 0;  // px
  int64_t y_q16 = 0;
  int64_t radius_q12 = 0;  // px, mean of the rays
  int64_t area_q8 = 0;     // px^2
  int64_t bright_q8 = 0;   // grey (image/difference.h) at the bright ends, mean
  bool is_seen = false;
};

class DiscEdge {
 public:
  static constexpr int kMinRadiusPx = 16;  // so that a ray's dark end lies in the disc
  static constexpr int kMaxRadiusPx = 200;

  // For discs of about this radius, in pictures of this size.
  DiscEdge(int width_px, int height_px, int radius_px);

  // Precondition: `about` lies in the picture.
  [[nodiscard]] DiscSight look(std::span<const uint16_t> grey, const DiscSight& about);

 private:
  static constexpr size_t kRays = 128;
  // One turn: every how many-th ray, and how far from the expected radius its ends and its steps reach, px.
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
  [[nodiscard]] DiscSight measure(const DiscSight& from, const Turn& turn) const;
  [[nodiscard]] Edge edge(const DiscSight& from, const Turn& turn, size_t ray) const;
  [[nodiscard]] int64_t sample(const DiscSight& from, size_t ray, int64_t r_q12) const;
  [[nodiscard]] bool is_inside(const DiscSight& from, size_t ray, int64_t r_q12) const;

  int width_px_;
  int height_px_;
  int side_px_;      // of the patch
  int left_px_ = 0;  // where it lies
  int top_px_ = 0;
  std::vector<uint16_t> row_;    // one row of the picture, with what it repeats
  std::vector<uint16_t> along_;  // smoothed along x
  std::vector<uint16_t> patch_;
  std::array<std::array<int32_t, 2>, kRays> direction_q14_{};
};

}  // namespace ruffini
