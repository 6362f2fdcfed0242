// libFuzzer: any bytes as a calibration file, and every question that the device asks of it.
#include <cstring>
#include <vector>

#include "estimators/wrench_covariance.h"
#include "solve/block_program.h"
#include "solve/node_sigma.h"
#include "store/calibration.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  std::vector<uint64_t> aligned((size + 7) / 8);
  if (size > 0) std::memcpy(aligned.data(), data, size);
  auto parsed = ruffini::Calibration::parse({reinterpret_cast<const uint8_t*>(aligned.data()), size});
  if (!parsed) return 0;
  const ruffini::Calibration& file = parsed.value();
  (void)file.has_kind("operator");
  (void)file.integer("operator.n_x", 0, 1000);
  (void)ruffini::BlockProgram::load(file, "operator", 4, 4);
  (void)ruffini::NodeSigmaModel::load(file, {4, 4}, 300);
  (void)ruffini::WrenchErrorModel::load(file, {.size_x_um = 20'000, .size_y_um = 16'000});
  ruffini::BoardSettings board;
  (void)file.check_target(board, "0000");
  return 0;
}
