// Flow of a texture (speckle, glitter) on the lattice of [markers] with polarity "texture": patches act as markers.
//
//   pictures   mean of B, G, R in Q4 levels, smoothed by (1 2 1) both ways; halved twice by 2 x 2 means
//   level 2    8 x 8 px, every second lattice point: whole-pixel search (4 px: 16 of the image), 3 x 3 median, a step,
//              median again
//   level 1    8 x 8 px, every lattice point, starting from its nearest coarse one: a step
//   level 0    16 px x 8 rows two apart: a step. Lost, and filled from neighbours, if the correlation with rest is
//              below threshold_1e3 / 1000 or the step exceeds a pixel; else the residual determines the quality
//   colours    a last step over B, G and R (image/colour_flow.h) around the patch's lattice position
//
// Always from the rest image to the current frame, without memory: no drift, no history. Not in the papers. Frame
// thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "board/settings.h"
#include "image/colour_flow.h"
#include "image/flow_templates.h"
#include "image/marker_graph.h"
#include "image/markers.h"

namespace ruffini {

class TextureFlow {
 public:
  static constexpr int kMinSizePx = 64;  // of the image: a template of the coarsest level with its margins

  explicit TextureFlow(const BoardSettings& board);

  // Makes templates from the rest image (B, G, R interleaved, 1/16 levels) and its grey as in image/difference.h.
  // Returns the number of patches with sufficient texture.
  int learn(std::span<const uint16_t> grey, std::span<const uint16_t> rest);
  // Tracks a frame and its grey. Returns the number of lost patches that were there at rest.
  int track(std::span<const uint16_t> grey, const FrameView& frame);

  [[nodiscard]] std::span<const Marker> markers() const { return markers_; }

 private:
  static constexpr size_t kLevels = 3;
  struct Picture {
    GridSize size;
    std::vector<int16_t> pixels;
    [[nodiscard]] GreyView view() const { return {pixels.data(), size.n_x, size.n_y, 1, size.n_x}; }
  };
  void build_pyramid(std::span<const uint16_t> grey);
  void smooth(std::span<const uint16_t> grey);
  static void halve(const Picture& from, Picture& to);
  void median();
  // Upsamples coarse displacements to the fine lattice, doubling their pixels.
  void spread();

  GridSize lattice_;
  MarkerGraph graph_;
  GridSize coarse_lattice_;
  int threshold_1e3_;
  std::array<Picture, kLevels> picture_;
  std::vector<int16_t> mean_;                     // one row of the mean, with one more pixel at either end
  std::vector<int16_t> row_;                      // three rows, smoothed along x
  std::array<std::vector<FlowVector>, 2> place_;  // of fine and coarse patches, Q16 px of the image
  std::vector<FlowTemplates> templates_;          // per level
  ColourFlow colours_;
  std::vector<FlowVector> coarse_;
  std::vector<FlowVector> coarse_next_;
  std::vector<FlowVector> u_;
  std::vector<uint8_t> is_cut_;
  std::vector<uint8_t> known_;
  std::vector<uint8_t> known_next_;
  std::vector<Marker> markers_;
};

}  // namespace ruffini
