// A small board with round numbers for the kernels' tests: 100 um per pixel, f = 200 px, H = 20 mm.
#pragma once

#include <algorithm>
#include <initializer_list>
#include <string>
#include <string_view>
#include <vector>

#include "board/settings.h"
#include "core/stages.h"

namespace ruffini::test {

// Stages that a board may list together: in the table's order each that those before it allow, without `left_out`.
inline std::vector<std::string> stages_but(std::initializer_list<std::string_view> left_out) {
  std::vector<std::string> stages;
  for (const std::string& stage : stage_names()) {
    if (std::ranges::find(left_out, stage) != left_out.end()) continue;
    stages.push_back(stage);
    if (!refuse_stages(stages).empty()) stages.pop_back();
  }
  return stages;
}

// Lists of stages that a board may have, which together have every stage.
inline std::vector<std::vector<std::string>> stages_by_turns() {
  return {stages_but({}),
          stages_but({"markers"}),                                                     // targets, feature_wrench
          stages_but({"markers", "targets"}),                                          // picture_features, softness
          stages_but({"markers", "targets", "picture_features"}),                      // spot_intensities
          stages_but({"markers", "targets", "picture_features", "spot_intensities"}),  // depth_moments
          stages_but({"markers", "feature_wrench"}),                                   // skin
          stages_but({"operator", "skin", "poisson"}),                                 // contact_model, contact_depth
          stages_but({"operator", "feature_wrench", "skin", "contact_model"})};        // fingertip
}

inline BoardSettings round_board() {
  BoardSettings board;
  board.name = "round";
  board.camera = {.optics = "test",
                  .width_px = 160,
                  .height_px = 120,
                  .rate_mhz = 60'000,
                  .focal_mpx = 200'000,
                  .center_x_mpx = 79'500,
                  .center_y_mpx = 59'500,
                  .standoff_um = 20'000};
  board.pad = {
      .size_x_um = 16'000, .size_y_um = 12'000, .thickness_um = 4'000, .modulus_pa = 200'000, .poisson_1e4 = 4'800};
  board.grid = {17, 13};
  board.n_layers = 4;
  board.window = {.min_x_um = 0, .min_y_um = 0, .max_x_um = 16'000, .max_y_um = 12'000};
  board.markers = {.polarity = Polarity::kDark,
                   .lattice = {9, 7},
                   .pitch_x_um = 1'500,
                   .pitch_y_um = 1'500,
                   .first_x_um = 2'000,
                   .first_y_um = 1'500,
                   .diameter_um = 600,
                   .threshold_1e3 = 120,
                   .max_lost = 6};
  board.depth = {.gauge = Gauge::kMargin, .margin_um = 1'000, .step_px = 1};
  board.contact = {.threshold_un = 3'000, .min_nodes = 4};
  board.force_lsb_un = 10;
  board.n_rest_frames = 2;
  board.stages = {"difference", "markers", "photometric", "poisson", "displacement", "operator", "wrench", "contacts"};
  return board;
}

}  // namespace ruffini::test
