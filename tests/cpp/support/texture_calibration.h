// A pad whose texture is followed, and a calibration of its contact model and its depth map: of any numbers, such that
// a flow outwards is a press.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "stages/contact_depth/contact_depth.h"
#include "support/calibration_bytes.h"
#include "support/test_board.h"

namespace ruffini::test {

inline BoardSettings contact_board() {
  BoardSettings board = round_board();
  board.name = "contact";
  board.markers.polarity = Polarity::kTexture;
  board.markers.max_lost = 20;
  board.stages = {"difference", "markers", "feature_wrench", "contact_model", "helmholtz", "contact_depth"};
  return board;
}

// Grey speckles; `out_px`: moved outwards from the picture's middle, so far where that is half its height away.
inline std::vector<uint8_t> speckles(const BoardSettings& board, double out_px) {
  const int width = board.camera.width_px;
  const int height = board.camera.height_px;
  std::vector<uint8_t> out;
  out.reserve(static_cast<size_t>(3 * width * height));
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const double back = 1 - 2 * out_px / height;
      const double at_x = width / 2.0 + (x - width / 2.0) * back;
      const double at_y = height / 2.0 + (y - height / 2.0) * back;
      const double wave = std::sin(0.9 * at_x + 0.4 * at_y) + std::sin(0.5 * at_x - 0.8 * at_y) +
                          std::sin(1.1 * at_y - 0.17 * at_x) + std::sin(0.31 * at_x * at_y / 40);
      out.insert(out.end(), 3, static_cast<uint8_t>(128 + 25 * wave));
    }
  }
  return out;
}

inline std::vector<uint8_t> contact_calibration(const BoardSettings& board) {
  const int n = board.markers.lattice.count();
  const auto columns = static_cast<size_t>(2 * n);
  const auto same = [](size_t size, int32_t value) { return std::vector<int32_t>(size, value); };
  std::vector<int32_t> gain(6 * columns);
  std::vector<int16_t> linear(static_cast<size_t>(n) * columns);
  for (int i = 0; i < n; ++i) {
    const int column = i % board.markers.lattice.n_x - board.markers.lattice.n_x / 2;
    gain[2 * columns + static_cast<size_t>(2 * i)] = -40 * column;  // outwards presses
    linear[static_cast<size_t>(i) * columns + static_cast<size_t>(2 * i)] = static_cast<int16_t>(100 * (column + 1));
  }
  CalibrationBytes file;
  file.meta("kinds", "contact_depth,contact_model,wrench")
      .meta("board", board.name)
      .meta("optics", board.camera.optics)
      .meta("resolution", std::to_string(board.camera.width_px) + "x" + std::to_string(board.camera.height_px))
      .meta("sensor_serial", "*")
      .meta("gel_serial", "*")
      .meta("created_utc", "2026-11-21T00:00:00Z")
      .meta("wrench.features", "markers")
      .meta("contact_model.least_fall_q16", "300")
      .meta("contact_model.least_force_un", "1000")
      .meta("contact_model.depth_sigma_um", "77")
      .meta("contact_model.moment_per_flow", "4321")
      .meta("contact_model.most_strange_q8", "16777216")
      .meta("contact_model.most_failing_q12", "65536")
      .meta("contact_depth.linear.out_shift", "7")
      .meta("contact_depth.sigma_um", "95");
  std::vector<int32_t> patch = same(25, 0);
  patch[0] = 1 << 12;  // of the first depth
  file.dense_program("contact_depth.linear", n, 2 * n)
      .tensor("contact_depth.net_hidden", "I32", {1, 25}, patch)
      .tensor("contact_depth.net_out", "I32", {1, 2}, std::vector<int32_t>{1 << 17, 1 << 16});
  for (const auto& [net, n_outputs] :
       {std::pair{"size", 4}, {"kind", 1}, {"fails", 1}, {"planar", 1}, {"hertzian", 1}}) {
    const std::string name = std::string("contact_model.") + net;
    std::vector<int32_t> out = same(2 * static_cast<size_t>(n_outputs), 0);
    for (size_t k = 1; k < out.size(); k += 2) out[k] = 2'000 << 5;
    file.tensor(name + "_hidden", "I32", {1, 19}, same(19, 1'000)).tensor(name + "_out", "I32", {n_outputs, 2}, out);
  }
  file.tensor("contact_model.odds", "I32", {4}, std::vector<int32_t>{4'096, 0, 0, 0})
      .tensor("contact_model.sigma", "I32", {2, 10}, same(20, 80))
      .tensor("contact_model.whitening", "I32", {16, 16}, same(256, 1'000))
      .tensor("wrench.error", "I32", {2, 6, 6}, same(72, 0))
      .tensor("wrench.full_scale", "I32", {6}, same(6, 1'000'000'000))
      .tensor("wrench.gain", "I32", {6, 2 * n}, gain)
      .tensor("wrench.square", "I32", {6, 21}, same(126, 0))
      .tensor("contact_model.mean", "I16", {16}, std::vector<int16_t>(16, 100));
  std::vector<int16_t> tanh(TanhTable::kSize);
  for (size_t i = 0; i < tanh.size(); ++i) {
    tanh[i] = static_cast<int16_t>(std::min(32'767.0, 32'768 * std::tanh(static_cast<double>(i) / 64)));
  }
  file.tensor("contact_model.tanh", "I16", {TanhTable::kSize}, tanh)
      .dense_entries("contact_depth.linear", n, 2 * n, linear)
      .dense_shifts("contact_depth.linear", n, 2 * n)
      .tensor("contact_depth.net_shift", "U8", {2}, std::vector<uint8_t>{12, 20});
  for (const char* net : {"size", "kind", "fails", "planar", "hertzian"}) {
    file.tensor(std::string("contact_model.") + net + "_shift", "U8", {2}, std::vector<uint8_t>{18, 20});
  }
  return file.tensor("wrench.shift", "U8", {6}, std::vector<uint8_t>(6, 4)).bytes();
}

}  // namespace ruffini::test
