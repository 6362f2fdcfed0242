// One frame on one path, for counting instructions (instructions.py): prints what is between two calls of the clock.
//
//   ruffini_one_frame FOLDER     FOLDER as ruffini_bench reads it
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <iterator>
#include <string>

#include "board/parse.h"
#include "frame_path.h"

namespace {

using namespace ruffini;

std::vector<uint8_t> read_file(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  if (!in) {
    std::cerr << path << ": cannot be read: run tests/bench/run.py, which makes it\n";
    std::exit(2);
  }
  return {std::istreambuf_iterator<char>(in), {}};
}

template <typename T>
T value_or_exit(Result<T> result) {
  if (!result) {
    std::cerr << result.error().message << "\n";
    std::exit(2);
  }
  return std::move(result).value();
}

}  // namespace

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
  const std::string folder = argv[1];
  const std::vector<uint8_t> toml = read_file(folder + "/board.toml");
  const BoardSettings board =
      value_or_exit(parse_board({reinterpret_cast<const char*>(toml.data()), toml.size()}, folder + "/board.toml"));
  const auto calibration = value_or_exit(CalibrationFile::load(read_file(folder + "/calibration.safetensors")));
  const auto path = value_or_exit(FramePath::configure(board, calibration, stage_boundary));
  const auto process = [&](const std::string& name) {
    const std::vector<uint8_t> pixels = read_file(folder + "/" + name);
    path->process(
        {pixels.data(), board.camera.width_px, board.camera.height_px, 3, ptrdiff_t{3} * board.camera.width_px});
  };
  for (int i = 0; i < board.n_rest_frames; ++i) process("rest.bgr");
  process("pressed.bgr");
  return 0;
}
