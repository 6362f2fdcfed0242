// As few pixels and nodes as make forces: a fuzzer starts a device some hundred times a second.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "support/test_board.h"

namespace ruffini::test {

inline BoardSettings small_board(std::vector<std::string> stages) {
  BoardSettings board = round_board();
  board.camera = {.optics = "test",
                  .width_px = 32,
                  .height_px = 24,
                  .rate_mhz = 60'000,
                  .focal_mpx = 40'000,
                  .center_x_mpx = 15'500,
                  .center_y_mpx = 11'500,
                  .standoff_um = 20'000};
  board.grid = {4, 3};
  board.stages = std::move(stages);
  return board;
}

}  // namespace ruffini::test
