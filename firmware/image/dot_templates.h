// Refines printed dots by all their pixels: one least-squares step from the dot's centre, against the rest image.
//
// Over the N pixels of a disc of the dot's radius plus 1.5 px, with luma T at rest in Q4 levels, its central
// differences g, and (x, y) relative to the marker's rest position:
//   h = g minus the part explained by 1, T - mean, x g and y g: insensitive to light, contrast, stretch, rotation
//   K = (sum h g^T)^-1, S_0 = sum h T, computed once, at rest
//   in a frame I, sampled at the pixels + d:  s = -K (sum h I - S_0), at most one pixel; d += 3/4 s
// On known displacement fields, this weighted mean of template and weighted centre is better than either alone.
//
//   expected error^2 = 0.01^2 + (K_xx + K_yy) R / N + (s / 2)^2 px^2; R: part of I not explained by T, light, contrast
// If the frame's disc correlates with the rest image by less than 1/2, it is not this dot and the error is unknown.
//
// Luma (117 B + 601 G + 306 R) / 1024 is used because video codecs preserve it better than colours. Frame thread; no
// allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "board/settings.h"
#include "image/dot_sums.h"
#include "image/markers.h"

namespace ruffini {

class DotTemplates {
 public:
  // Larger dots are measured by their weighted centre only.
  static constexpr int kMaxRadiusPx = DotWindow::kMaxRadiusPx;
  static constexpr int64_t kUnknown = 1 << 20;  // error^2 of something that is not the dot, Q16 px

  DotTemplates(const BoardSettings& board, DotSumsRun version);
  explicit DotTemplates(const BoardSettings& board);  // selects the fastest version that this processor supports

  // `rest`: width x height x 3 in 1/16 grey levels.
  void learn(std::span<const uint16_t> rest, std::span<const Marker> markers);
  // Refines the displacement of markers that are not lost, and writes the expected error of each, Q16 px squared. Dots
  // near the picture's border keep the position and the error of the weighted centre.
  void refine(const FrameView& frame, std::span<Marker> markers, std::span<int64_t> error2_q16);

 private:
  struct Template {
    int x = 0;  // middle pixel
    int y = 0;
    int shift = 0;  // from K ds to Q16 px; 0: no usable template
    std::array<int64_t, 4> k{};
    int64_t s0_x = 0;
    int64_t s0_y = 0;
    int64_t tt = 0;
    int64_t t_sum = 0;
  };
  struct Pixel {
    int x = 0;  // relative to the centre pixel
    int y = 0;
    size_t at = 0;  // in the window's values (dot_sums.h)
  };
  using Values = std::vector<int64_t>;
  void learn_one(std::span<const uint16_t> rest, const Marker& marker, size_t number);
  void invert(Template& one, const Values& gx, const Values& gy, size_t number) const;
  void remove_nuisances(size_t number);
  [[nodiscard]] size_t first(size_t number) const { return number * keep_.size(); }
  void refine_one(const FrameView& frame, size_t number, Marker& marker, int64_t& error2_q16);

  int width_px_;
  int height_px_;
  DotSumsRun run_;
  int radius_px_;
  std::vector<Pixel> pixels_;
  std::vector<Template> templates_;
  // Of each template, for each of the window's values; 0 outside the disc.
  std::array<std::vector<int16_t>, 2> h_;
  std::vector<int16_t> t_;
  std::vector<int16_t> keep_;
  std::vector<int16_t> window_;  // luma around one dot in a frame
  Values sample_;                // of one template
  std::array<Values, 2> gradient_;
  std::array<Values, 6> nuisance_;  // nuisance directions, mutually orthogonal
  Values free_;
};

}  // namespace ruffini
