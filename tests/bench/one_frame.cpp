// One frame on one path, for counting instructions (instructions.py): prints what is between two calls of the clock.
//
//   ruffini_one_frame FOLDER     FOLDER as ruffini_bench reads it
#include <cstdint>
#include <iostream>

#include "recorded_input.h"

// Its address in the trace parts the stages; time does not matter here.
extern "C" __attribute__((noinline)) uint64_t stage_boundary() {
  static uint64_t n_calls = 0;
  return ++n_calls;
}

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: ruffini_one_frame FOLDER\n";
    return 2;
  }
  const ruffini::bench::Input input(argv[1]);
  const auto path =
      ruffini::bench::value_or_exit(ruffini::FramePath::configure(input.board, input.calibration, stage_boundary));
  for (int i = 0; i < input.board.n_rest_frames; ++i) path->process(input.view(input.rest));
  path->process(input.view(input.pressed));
  return 0;
}
