// Printed dots by all their ink: one step of least squares from the centre of the dot, against the picture at rest.
//
// Over the N pixels of a disc of the dot's radius and 1.5 px, luma T at rest in Q4 levels, g its central differences,
// (x, y) from where the marker rests:
//   h = g without what 1, T - mean, x g and y g explain    blind to light, contrast, stretch, turn
//   K = (sum h g^T)^-1, S_0 = sum h T, all made once, at rest
//   in a frame I, sampled at the pixels + d:  s = -K (sum h I - S_0), at most one pixel; d becomes d + 3/4 s
// The quarter left is what the weighted centre knows better on known fields; both together are better than each.
//
//   expected error^2 = 0.01^2 + (K_xx + K_yy) R / N + (s / 2)^2 px^2, R of I unexplained by T, light and contrast aside
// A frame's disc that correlates with that at rest by less than 1/2 is not this dot: the error is unknown.
//
// Luma (117 B + 601 G + 306 R) / 1024: video codecs keep it better than colours. Frame thread; no allocation after the
// constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "board/settings.h"
#include "image/markers.h"

namespace ruffini {

class DotTemplates {
 public:
  static constexpr int kMaxRadiusPx = 12;       // larger dots are taken by their middle
  static constexpr int64_t kUnknown = 1 << 20;  // error^2 of what is not the dot, Q16 px

  explicit DotTemplates(const BoardSettings& board);

  // `rest` is width x height x 3 in 1/16 grey levels.
  void learn(std::span<const uint16_t> rest, std::span<const Marker> markers);
  // Moves the displacement of markers that are not lost, and says how far each may be off, Q16 px squared. Dots near the
  // picture's border stay as they are, and as good as the weighted centre is.
  void refine(const FrameView& frame, std::span<Marker> markers, std::span<int64_t> error2_q16);

 private:
  struct Template {
    int x = 0;  // middle pixel
    int y = 0;
    int shift = 0;  // of K ds to Q16 px; 0: not sound
    std::array<int64_t, 4> k{};
    int64_t s0_x = 0;
    int64_t s0_y = 0;
    int64_t tt = 0;
    int64_t t_sum = 0;
  };
  struct Pixel {
    int x = 0;  // from the middle
    int y = 0;
  };
  using Values = std::vector<int64_t>;
  void learn_one(std::span<const uint16_t> rest, const Marker& marker, size_t number);
  void invert(Template& one, const Values& gx, const Values& gy, const int32_t* h) const;
  void blind(size_t number);
  void see(const FrameView& frame, int x, int y);
  void refine_one(const FrameView& frame, size_t number, Marker& marker, int64_t& error2_q16);

  int width_px_;
  int height_px_;
  int radius_px_;
  std::vector<Pixel> pixels_;
  std::vector<Template> templates_;
  std::vector<int32_t> h_;  // per template: h_x and h_y of each pixel, side by side
  std::vector<int32_t> t_;
  std::vector<int32_t> window_;  // luma of one dot's surroundings in a frame
  Values sample_;                // of one template
  std::array<Values, 2> gradient_;
  std::array<Values, 6> nuisance_;  // what h is freed of, freed of one another
  Values free_;
};

}  // namespace ruffini
