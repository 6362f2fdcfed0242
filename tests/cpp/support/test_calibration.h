// A calibration of every kind for a board, simple enough to reason about: force = gain x displacement.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "frame_path.h"
#include "support/calibration_bytes.h"

namespace ruffini::test {

// Operator and support are diagonal and agree: F = 20 steps of force per 125 nm. Blue bends to slope x, green to slope
// y. A relaxing pad loses 30 % of its force within a second. `gates`: what its report says.
inline std::vector<uint8_t> diagonal_calibration(const BoardSettings& board, bool is_relaxing = false,
                                                 const std::string& gates = "") {
  const GridSize nodes = NodeGrid(board).size();
  const int n = 3 * nodes.count();
  const auto diagonal = [&](int16_t value) {
    std::vector<int16_t> out(static_cast<size_t>(n * n));
    for (int i = 0; i < n; ++i) out[static_cast<size_t>(i * n + i)] = value;
    return out;
  };
  const int n_q = 65;
  std::vector<int16_t> unmix(13 * 17 * 2 * 3);
  for (size_t i = 0; i < unmix.size(); i += 6) {
    unmix[i] = 8'192;      // slope x of blue
    unmix[i + 4] = 8'192;  // slope y of green
  }
  std::vector<int16_t> slope(static_cast<size_t>(n_q * n_q * 2));
  for (int y = 0; y < n_q; ++y) {
    for (int x = 0; x < n_q; ++x) {
      slope[static_cast<size_t>((y * n_q + x) * 2)] = static_cast<int16_t>((x - 32) * 128);
      slope[static_cast<size_t>((y * n_q + x) * 2 + 1)] = static_cast<int16_t>((y - 32) * 128);
    }
  }
  CalibrationBytes file;
  file.meta("kinds", std::string("operator,support,photometric") + (is_relaxing ? ",relaxation" : ""))
      .meta("board", board.name)
      .meta("optics", board.camera.optics)
      .meta("resolution", std::to_string(board.camera.width_px) + "x" + std::to_string(board.camera.height_px))
      .meta("sensor_serial", "*")
      .meta("gel_serial", "*")
      .meta("version", "1")
      .meta("security_epoch", "0")
      .meta("created_utc", "2026-11-21T00:00:00Z")
      .meta("operator.n_x", std::to_string(nodes.n_x))
      .meta("operator.n_y", std::to_string(nodes.n_y))
      .meta("operator.force_lsb_un", std::to_string(board.force_lsb_un))
      .meta("operator.displacement_lsb_nm", "125")
      .meta("operator.out_shift", "9")  // 10240 / 2^9 = 20
      .meta("support.normal.out_shift", "5")
      .meta("support.project.out_shift", "7")
      .meta("support.shear_noise", "0")
      .tensor("support.scale", "I32", {n}, std::vector<int32_t>(static_cast<size_t>(n), 5'120 << 16))
      .tensor("support.error_local", "I32", {2, 4},
              std::vector<int32_t>{65'536, 0, 0, 0, 65'536, 0, 0, 0})                // all of the reading
      .tensor("support.error_quiet", "I32", {2, 7},                                  // 5 and 6 steps
              std::vector<int32_t>{6'400, 6'400, 6'400, 6'400, 6'400, 6'400, 6'400,  //
                                   9'216, 9'216, 9'216, 9'216, 9'216, 9'216, 9'216})
      .tensor("support.error_reported", "I32", {2, 12}, std::vector<int32_t>(24, 25 << 8))
      .tensor("support.error_wrench", "I32", {4, 2}, std::vector<int32_t>{2'000, 7'000, 8'000, 3'000, 0, 0, 0, 0});
  if (!gates.empty()) file.meta("gates", gates);
  if (is_relaxing) {
    file.meta("relaxation.terms", "1")
        .tensor("relaxation.part", "I32", {1}, std::vector<int32_t>{314'573})
        .tensor("relaxation.time_ms", "I32", {1}, std::vector<int32_t>{1'000});
  }
  return file.dense_program("operator", n, n)
      .dense_program("support.normal", n, n)
      .dense_program("support.project", n, n)
      .dense_entries("operator", n, n, diagonal(10'240))
      .dense_entries("support.normal", n, n, diagonal(8'192))
      .dense_entries("support.project", n, n, diagonal(8'192))
      .tensor("photometric.unmix", "I16", {13, 17, 2, 3}, unmix)
      .tensor("photometric.slope", "I16", {n_q, n_q, 2}, slope)
      .dense_shifts("operator", n, n)
      .dense_shifts("support.normal", n, n)
      .dense_shifts("support.project", n, n)
      .bytes();
}

}  // namespace ruffini::test
