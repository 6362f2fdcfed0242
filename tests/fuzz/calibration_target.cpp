// libFuzzer: any bytes as a calibration file, and every question that the device asks of it; a path is configured with it as
// if its signature were right, and looks at pictures. An input that is too short for a file says what of a good one is spoilt.
#include <cstring>
#include <vector>

#include "estimators/wrench_covariance.h"
#include "frame_path.h"
#include "input.h"
#include "solve/block_program.h"
#include "solve/node_sigma.h"
#include "store/calibration.h"
#include "support/small_board.h"
#include "support/test_calibration.h"

namespace {

using ruffini::fuzz::Bytes;

constexpr size_t kShort = 64;

struct Sensor {
  ruffini::BoardSettings board;
  Bytes good;  // its calibration
};

const std::vector<Sensor>& sensors() {
  static const std::vector<Sensor> kSensors = [] {
    std::vector<Sensor> out;
    for (const auto& stages : ruffini::test::stages_by_turns()) {
      const ruffini::BoardSettings board = ruffini::test::small_board(stages);
      out.push_back({board, ruffini::test::diagonal_calibration(board)});
    }
    return out;
  }();
  return kSensors;
}

void configure(const ruffini::BoardSettings& board, std::span<const uint8_t> bytes) {
  static const std::vector<uint8_t> kPixels(size_t{3} * 32 * 24, 90);
  auto loaded = ruffini::CalibrationFile::load({bytes.begin(), bytes.end()});
  if (!loaded) return;
  auto path = ruffini::FramePath::configure(board, loaded.value(), [] { return uint64_t{0}; });
  if (!path) return;
  for (int i = 0; i < board.n_rest_frames + 2; ++i) {
    path.value()->process({kPixels.data(), 32, 24, 3, ptrdiff_t{3} * 32}, 1'000 * static_cast<uint64_t>(i));
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const Sensor& sensor = sensors()[size == 0 ? 0 : data[size - 1] % sensors().size()];
  Bytes bytes(data, data + size);
  if (size <= kShort) bytes = ruffini::fuzz::Input(data, size).spoilt(sensor.good);
  std::vector<uint64_t> aligned((bytes.size() + 7) / 8);
  if (!bytes.empty()) std::memcpy(aligned.data(), bytes.data(), bytes.size());
  auto parsed = ruffini::Calibration::parse({reinterpret_cast<const uint8_t*>(aligned.data()), bytes.size()});
  if (!parsed) return 0;
  const ruffini::Calibration& file = parsed.value();
  (void)file.has_kind("operator");
  (void)file.integer("operator.n_x", 0, 1000);
  (void)ruffini::BlockProgram::load(file, "operator", 4, 4);
  (void)ruffini::NodeSigmaModel::load(file, {4, 4}, 300);
  (void)ruffini::WrenchErrorModel::load(file, {.size_x_um = 20'000, .size_y_um = 16'000});
  ruffini::BoardSettings board;
  (void)file.check_target(board, "0000");
  configure(sensor.board, bytes);
  return 0;
}
