// Map of the gel's indentation depth, from the flow of a texture under one contact.
//
//   a       D u        block program `contact_depth.linear`: the flow (1/16 um, x and y of each patch) to a first
//                      depth of each patch, 1/16 um; best linear estimate over calibrated presses
//   inputs  per patch: a, a smoothed by (1 2 1) both ways twice and eight times, the largest a, all divided by the
//                      profile's size (Q10); fall of the density over that size (Q16 over Q4, Q8); distance from the
//                      contact's centre, um; then the inputs of the contact model for the whole frame
//   depth   perceptron `contact_depth.net` of these, over the profile's size, Q12; negative where the gel bulges
//   map     cells of the image, `step_px` wide: a cell sees the position P = (p - c) H / f of the undeformed pad; the
//                      material there was at X = P - d(X), d the flow (two rounds), and has the depth at X, bilinear
//
// A patch is 3 mm wide, so edges are equally soft. Without contact the map is zero. Not in the paper, which scales the
// density. Frame thread; no allocation after load.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "base/result.h"
#include "board/settings.h"
#include "core/results.h"
#include "estimators/perceptron.h"
#include "image/displacement.h"
#include "solve/block_program.h"
#include "store/calibration.h"

namespace ruffini {

class ContactDepth {
 public:
  static constexpr size_t kOfPatch = 6;
  static constexpr size_t kInputs = kOfPatch + ModelledContact::kInputs;

  // True if the board has the stage contact_depth and no depth from light.
  [[nodiscard]] static bool is_used_by(const BoardSettings& board);
  // The cell size is the spacing of the patches, but at least [depth] step_px.
  [[nodiscard]] static int step_px(const BoardSettings& board);
  [[nodiscard]] static GridSize cells(const BoardSettings& board);

  // Loads kind "contact_depth" of the calibration, which must also have the kind "contact_model". Errors: kBadInput.
  [[nodiscard]] static Result<ContactDepth> load(const Calibration& calibration, const BoardSettings& board);

  // out: u_z of each cell, negative where pressed. `inputs`: those of the contact model in this frame.
  void run(const Profile& profile, const ModelledContact::Inputs& inputs, std::span<DisplacementUm> out,
           SaturationCounter& saturations);
  // Standard deviation of a touched cell, measured on presses that were excluded from the fit.
  [[nodiscard]] int64_t sigma_um() const { return sigma_um_; }

 private:
  explicit ContactDepth(const BoardSettings& board);
  void estimate(std::span<const FlowPoint> flow, SaturationCounter& saturations);
  void smooth(std::vector<int64_t>& plane);
  void refine(std::span<const int32_t> fall, const Profile& profile, const ModelledContact::Inputs& inputs,
              SaturationCounter& saturations);
  void resample(std::span<const FlowPoint> flow, std::span<DisplacementUm> out, SaturationCounter& saturations) const;

  GridSize lattice_;
  GridSize cells_;
  FlowPoint pitch_;  // um, as the next
  FlowPoint first_;  // patch, from the pad's middle
  int64_t step_px_;
  int64_t um_per_px_q20_;
  int64_t center_x_mpx_;
  int64_t center_y_mpx_;
  int64_t sigma_um_ = 0;
  BlockProgram linear_;
  TanhTable tanh_;
  Perceptron net_;
  std::vector<int16_t> seen_;
  std::array<std::vector<int64_t>, 3> plane_;  // a, and smoothed twice and eight times
  std::vector<int64_t> line_;
  std::vector<int64_t> depth_q4_;
};

}  // namespace ruffini
