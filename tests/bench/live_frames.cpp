// A live camera's frames, for counting what its checks cost (check_costs.py).
//
//   ruffini_live_frames FOLDER N_REST    board.toml, calibration.safetensors, and frames.bgr: N_REST untouched pictures
//                                        that are learned, then those that are counted, one after the other
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <iostream>
#include <span>
#include <string>

#include "recorded_input.h"

namespace {

constexpr uint64_t kFrameUs = 16'667;

uint64_t no_clock() { return 0; }

}  // namespace

// By this name the count is switched on and off.
extern "C" __attribute__((noinline)) uint32_t counted_frame(ruffini::FramePath& path, const ruffini::FrameView& view,
                                                            uint64_t capture_us) {
  return path.process(view, capture_us).flags;
}

int main(int argc, char** argv) {
  using ruffini::bench::read_file;
  using ruffini::bench::value_or_exit;
  if (argc != 3) {
    std::cerr << "usage: ruffini_live_frames FOLDER N_REST\n";
    return 2;
  }
  const std::string folder = argv[1];
  const std::string name = folder + "/board.toml";
  const std::vector<uint8_t> toml = read_file(name);
  const ruffini::BoardSettings board =
      value_or_exit(ruffini::parse_board({reinterpret_cast<const char*>(toml.data()), toml.size()}, name));
  const auto calibration =
      value_or_exit(ruffini::CalibrationFile::load(read_file(folder + "/calibration.safetensors")));
  const auto path = value_or_exit(ruffini::FramePath::configure(board, calibration, no_clock));
  path->set_live(true);
  const std::vector<uint8_t> frames = read_file(folder + "/frames.bgr");
  const auto stride = ptrdiff_t{3} * board.camera.width_px;
  const auto frame_bytes = static_cast<size_t>(stride * board.camera.height_px);
  const size_t n_rest = std::strtoul(argv[2], nullptr, 10);
  for (size_t i = 0; (i + 1) * frame_bytes <= frames.size(); ++i) {
    const ruffini::FrameView view{frames.data() + i * frame_bytes, board.camera.width_px, board.camera.height_px, 3,
                                  stride};
    const uint64_t now_us = (i + 1) * kFrameUs;
    if (i < n_rest) {
      path->process(view, now_us);
    } else {
      std::cout << counted_frame(*path, view, now_us) << "\n";
    }
  }
  return 0;
}
