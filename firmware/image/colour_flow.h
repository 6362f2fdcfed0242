// Last step of the texture flow, over three colours: patches of 24 x 22 px that ignore changes other than displacement.
//
//   pictures   B, G and R in Q4 levels, smoothed by (1 2 1) both ways
//   patch      three blocks of 8 columns and 8 rows three pixels apart, around its lattice position
//   h          per colour: central differences g minus the part explained by the colour's level, its contrast and a
//              linear deformation about the centre: 1, T, g_x x, g_x y, g_y x, g_y y  (image/flow_nuisances.h)
//   step       u -= K sum over colours (sum h I - S_0),  K = (sum over colours sum h g^T)^-1; at most one pixel
//
// Flakes of glitter flash while the surface under them tilts, and grey mistakes a flash beside a patch's centre for a
// shift. A flake's colour does not change, so each colour sees its own flakes. On the twin of the glitter board the
// error of a patch falls from 10.9 um to 6.4 um (under a ball, 1.2 mm deep). A patch with too little contrast, or one
// that reaches beyond the picture's border, keeps its u. Not in the papers, which use grey flow. Frame thread; no
// allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "image/flow_inverse.h"
#include "image/flow_kernel.h"
#include "image/flow_nuisances.h"
#include "image/flow_templates.h"

namespace ruffini {

class ColourFlow {
 public:
  ColourFlow(GridSize image, size_t n_patches);

  // Extracts the patches around `places` (Q16 px) from the rest image (B, G, R interleaved, 1/16 levels).
  void learn(std::span<const uint16_t> rest, std::span<const FlowVector> places);
  // Performs one step for each patch. Sets is_cut to 1 where the step would have exceeded one pixel, and raises
  // `quality`, which the grey flow has set: on generated speckle and glitter the error falls to two thirds.
  void step(const FrameView& frame, std::span<FlowVector> u, std::span<uint8_t> is_cut, std::span<uint8_t> quality);

  [[nodiscard]] bool is_sound(size_t patch) const { return patch_[patch].inverse.shift != 0; }

 private:
  static constexpr size_t kColours = 3;
  static constexpr PatchShape kShape{.n_blocks = 3, .row_step = 3, .margin_px = 1};
  static constexpr size_t kSamples = size_t{3} * flow_kernel::kArea;
  struct Patch {
    int x = 0;  // first pixel
    int y = 0;
    FlowInverse inverse;
    int64_t s0_x = 0;
    int64_t s0_y = 0;
  };
  // Samples of one colour of a patch, in block order.
  struct Samples {
    std::array<int32_t, kSamples> value{};
    std::array<int32_t, kSamples> g_x{};
    std::array<int32_t, kSamples> g_y{};
  };

  template <typename Level>
  void smooth(const Level* pixels, ptrdiff_t stride, int unit_shift);
  void learn_patch(size_t number, const FlowVector& place);
  void sample(const Patch& patch, size_t colour, Samples& out) const;
  // Collects the nuisance directions of the samples around the centre: all changes other than displacement.
  void add_nuisances(const Patch& patch, const FlowVector& place, const Samples& samples);
  [[nodiscard]] GreyView view(size_t colour) const;
  // True if all samples of a patch that begins at this pixel are in the picture.
  [[nodiscard]] bool is_inside(int64_t x_q16, int64_t y_q16) const;
  [[nodiscard]] int16_t* gradient(size_t patch, size_t colour) {
    return h_.data() + 2 * kSamples * (kColours * patch + colour);
  }

  GridSize image_;
  const flow_kernel::Version& kernel_;
  std::array<std::vector<int16_t>, kColours> picture_;
  std::vector<uint16_t> row_;  // three rows, smoothed along x, colours interleaved
  std::vector<Patch> patch_;
  std::vector<int16_t> h_;  // per patch, colour and block: h_x of 64 samples, h_y of 64
  FlowNuisances nuisances_;
};

}  // namespace ruffini
