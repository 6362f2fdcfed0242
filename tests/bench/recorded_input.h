// What the benchmarks read: a folder that tests/bench/benchmarks.py makes.
#pragma once

#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "board/parse.h"
#include "frame_path.h"
#include "store/huge_pages.h"

namespace ruffini::bench {

inline std::vector<uint8_t> read_file(const std::string& path) {
  std::ifstream in(path, std::ios::binary | std::ios::ate);
  if (!in) {
    std::cerr << path << ": cannot be read: run tests/bench/benchmarks.py, which makes it\n";
    std::exit(2);
  }
  std::vector<uint8_t> bytes = bytes_in_huge_pages(static_cast<size_t>(in.tellg()));  // as ruffinid has its calibration
  in.seekg(0);
  in.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  return bytes;
}

template <typename T>
T value_or_exit(Result<T> result) {
  if (!result) {
    std::cerr << result.error().message << "\n";
    std::exit(2);
  }
  return std::move(result).value();
}

// board.toml, calibration.safetensors and pictures: rest, pressed, and both again with other noise.
struct Input {
  BoardSettings board;
  std::shared_ptr<const CalibrationFile> calibration;
  std::vector<uint8_t> rest;
  std::vector<uint8_t> untouched;
  std::vector<uint8_t> pressed;
  std::vector<uint8_t> pressed_again;

  explicit Input(const std::string& folder)
      : rest(read_file(folder + "/rest.bgr")),
        untouched(read_file(folder + "/untouched.bgr")),
        pressed(read_file(folder + "/pressed.bgr")),
        pressed_again(read_file(folder + "/pressed_again.bgr")) {
    const std::string name = folder + "/board.toml";
    const std::vector<uint8_t> toml = read_file(name);
    board = value_or_exit(parse_board({reinterpret_cast<const char*>(toml.data()), toml.size()}, name));
    calibration = value_or_exit(CalibrationFile::load(read_file(folder + "/calibration.safetensors")));
  }
  [[nodiscard]] FrameView view(const std::vector<uint8_t>& pixels) const {
    return {pixels.data(), board.camera.width_px, board.camera.height_px, 3, ptrdiff_t{3} * board.camera.width_px};
  }
};

}  // namespace ruffini::bench
