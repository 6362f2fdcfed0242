// Patches of the rest image on one pyramid level, prepared for matching in a frame.
//
// Per patch, over its N samples T with central differences g:
//   t = T - mean, h = g - mean - t (g . t) / (t . t)       insensitive to the light's level and contrast
//   K = (sum h g^T)^-1, S_0 = sum h T
// One step in a frame I, sampled at the patch's position + u:  u -= K (sum h I - S_0), at most one pixel. The method is
// inverse compositional: everything but the samples is computed once, at rest. The displacement applies to the patch's
// centre of texture (mean of h . g). A patch without contrast, or with contrast along one direction only, is not
// usable.
//
// The part of a frame's samples that the template does not explain, R = I . I - (I . t)^2 / t . t, moves a step by
//   error^2 = 4 (K_xx + K_yy) R / N     px^2; 4, because smoothing correlates the errors of neighbouring samples
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "image/flow_inverse.h"
#include "image/flow_kernel.h"

namespace ruffini {

struct FlowVector {
  int32_t x_q16 = 0;  // pixels of its level
  int32_t y_q16 = 0;
};

using GreyView = ImageView<const int16_t>;  // Q4 levels

// Sampling pattern of a patch: n_blocks blocks side by side, 8 rows of samples that are row_step rows apart.
struct PatchShape {
  int n_blocks = 1;
  int row_step = 1;
  int margin_px = 1;  // distance of the template from the picture's border

  [[nodiscard]] int columns() const { return n_blocks * flow_kernel::kSide; }
  [[nodiscard]] int rows() const { return flow_kernel::kSide * row_step; }
  [[nodiscard]] int n_samples() const { return n_blocks * flow_kernel::kArea; }
};

// Returns the position of block `number` of a patch that begins at (x, y), Q16, clamped to the picture.
[[nodiscard]] flow_kernel::Block block_at(const GreyView& picture, const PatchShape& shape, int64_t x_q16,
                                          int64_t y_q16, int number);

class FlowTemplates {
 public:
  static constexpr int kMaxBlocks = 2;
  static constexpr int kSearchPx = 4;  // search radius of search() in whole pixels; at most the margin

  FlowTemplates(PatchShape shape, int n_patches);

  // `places`: centres, Q16 px of this level.
  void learn(const GreyView& picture, std::span<const FlowVector> places);
  // Moves u to the whole pixel where the template fits best, ignoring the light's level.
  void search(const GreyView& picture, std::span<FlowVector> u) const;
  // Performs one step for each patch. Sets is_cut to 1 where the step would have exceeded one pixel.
  void step(const GreyView& picture, std::span<FlowVector> u, std::span<uint8_t> is_cut) const;
  // Writes the marker quality if the samples at u correlate with the template by at least threshold / 1000; else 0.
  void compare(const GreyView& picture, std::span<const FlowVector> u, int threshold_1e3,
               std::span<uint8_t> quality) const;

  [[nodiscard]] bool is_sound(size_t patch) const { return patch_[patch].inverse.shift != 0; }
  // The centre of texture, Q16 px.
  [[nodiscard]] FlowVector center(size_t patch) const { return patch_[patch].center; }

 private:
  struct Patch {
    int x = 0;  // first pixel
    int y = 0;
    FlowVector center;
    FlowInverse inverse;
    int64_t s0_x = 0;
    int64_t s0_y = 0;
    int64_t tt = 0;  // t . t
    int64_t t_sum = 0;
  };
  void learn_patch(const GreyView& picture, size_t patch);
  void invert(Patch& patch, std::span<const int32_t> gx, std::span<const int32_t> gy, const int16_t* h) const;
  void remove_nuisances(std::span<const int32_t> g, const int16_t* t, int64_t tt, size_t axis, int16_t* h) const;
  [[nodiscard]] uint8_t quality_of(const Patch& patch, int64_t unexplained) const;
  [[nodiscard]] flow_kernel::Block block(const GreyView& picture, const Patch& patch, const FlowVector& u,
                                         int number) const;

  PatchShape shape_;
  const flow_kernel::Version& kernel_;
  std::vector<Patch> patch_;
  std::vector<int16_t> h_;      // per patch and block: h_x of 64 samples, h_y of 64
  std::vector<int16_t> t_;      // per patch and block: 64
  std::vector<int16_t> value_;  // T itself, in the same layout
};

}  // namespace ruffini
