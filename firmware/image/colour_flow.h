// The last step of a texture's flow, over its three colours: patches of 24 x 22 px that are blind to what is no shift.
//
//   pictures   B, G and R in Q4 levels, smoothed by (1 2 1) both ways
//   patch      three blocks of 8 columns, 8 rows three apart, about its place on the lattice
//   h          per colour: central differences g less what the colour's level, its contrast and a linear deformation
//              about the place explain: 1, T, g_x x, g_x y, g_y x, g_y y  (image/flow_nuisances.h)
//   step       u -= K sum over colours (sum h I - S_0),  K = (sum over colours sum h g^T)^-1; at most a pixel
//
// Flakes of glitter flash while the surface under them tilts, and grey takes a flash beside a patch's middle for a
// shift. A flake's colour does not change: each colour knows its own flakes, and between two colours the light is alike.
// On the twin of the glitter board what a patch errs by falls from 10.9 um to 6.4 (under a ball, 1.2 mm deep).
// A patch whose colours say too little, or that reaches over the picture's border, keeps the u that it has. Not in any of the papers, whose flow is of grey.
// Frame thread; no allocation after the constructor.
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

  // Patches about `places`, Q16 px, from the rest image: B, G, R interleaved, 1/16 levels.
  void learn(std::span<const uint16_t> rest, std::span<const FlowVector> places);
  // One step each. is_cut becomes 1 where it would have been longer than a pixel; `quality`, as grey has left it, grows:
  // on generated speckle and glitter the error falls to two thirds.
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
  // Samples of one colour of a patch, in the order of the blocks.
  struct Samples {
    std::array<int32_t, kSamples> value{};
    std::array<int32_t, kSamples> g_x{};
    std::array<int32_t, kSamples> g_y{};
  };

  template <typename Level>
  void see(const Level* pixels, ptrdiff_t stride, int unit_shift);
  void learn_patch(size_t number, const FlowVector& place);
  void sample(const Patch& patch, size_t colour, Samples& out) const;
  // What the samples do about the place, beside moving.
  void blind_to(const Patch& patch, const FlowVector& place, const Samples& samples);
  [[nodiscard]] GreyView view(size_t colour) const;
  // Whether all samples of a patch with its first pixel there are in the picture.
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
