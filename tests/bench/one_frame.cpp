// An untouched frame, the first of a press and the next one, for counting instructions (instructions.py).
//
//   ruffini_one_frame FOLDER     FOLDER as ruffini_bench reads it
#include <cstdint>
#include <iostream>

#include "recorded_input.h"

// The counter (stage_counts.c) parts the stages at its calls; time does not matter here.
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
  for (const auto* picture : {&input.untouched, &input.pressed, &input.pressed_again})
    path->process(input.view(*picture));
  return 0;
}
