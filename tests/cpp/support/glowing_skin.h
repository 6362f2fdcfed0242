// A small skin that glows, its calibration, and pictures of it: untouched, and with two touches.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "support/calibration_bytes.h"
#include "support/test_board.h"

namespace ruffini::test {

inline constexpr int kOpeningPx = 8;  // side of an opening, in the picture
inline constexpr int kOpeningPitchPx = 15;

inline BoardSettings glowing_board() {
  BoardSettings board = round_board();
  board.stages = {"skin"};
  board.skin = {.weights = {1, 1, 0}, .level = 30, .min_area_px = 20, .averaged_frames = 3};
  return board;
}

// Grey level of opening i is `level` (1 + gain exp(-distance)) about the openings `touched`.
inline std::vector<uint8_t> glowing_picture(const BoardSettings& board, const std::vector<int>& touched, double gain) {
  const int n_x = board.markers.lattice.n_x;
  std::vector<uint8_t> bgr(static_cast<size_t>(3 * board.camera.width_px * board.camera.height_px));
  for (int i = 0; i < board.markers.lattice.count(); ++i) {
    double level = 40;
    for (const int other : touched) {
      level += 40 * gain * std::exp(-std::hypot(i % n_x - other % n_x, i / n_x - other / n_x) / 0.6);
    }
    for (int y = 0; y < kOpeningPx; ++y) {
      for (int x = 0; x < kOpeningPx; ++x) {
        const int at = (i / n_x * kOpeningPitchPx + y + 4) * board.camera.width_px + i % n_x * kOpeningPitchPx + x + 10;
        for (int c = 0; c < 3; ++c) bgr[static_cast<size_t>(3 * at + c)] = static_cast<uint8_t>(std::min(level, 255.0));
      }
    }
  }
  return bgr;
}

// Force goes with the square of the sink, with a memory; a touch falls off to 1 / e within 0.6 of the pitch.
inline std::vector<uint8_t> skin_calibration(const BoardSettings& board) {
  const GridSize size = board.markers.lattice;
  const int n = size.count();
  const int64_t pitch_um = board.markers.pitch_x_um;
  std::vector<int32_t> runs;
  std::vector<int32_t> places;
  std::vector<int16_t> near;
  for (int i = 0; i < n; ++i) {
    const int column = i % size.n_x;
    const int row = i / size.n_x;
    for (int y = 0; y < kOpeningPx; ++y) {
      runs.insert(runs.end(), {(row * kOpeningPitchPx + y + 4) * board.camera.width_px + column * kOpeningPitchPx + 10,
                               kOpeningPx, i});
    }
    places.insert(places.end(), {static_cast<int32_t>((2 * column - size.n_x + 1) * pitch_um / 2),
                                 static_cast<int32_t>((2 * row - size.n_y + 1) * pitch_um / 2)});
    constexpr int kSteps[8][2] = {{-1, 0}, {1, 0}, {0, -1}, {0, 1}, {-1, -1}, {1, -1}, {-1, 1}, {1, 1}};
    for (const auto& [dx, dy] : kSteps) {
      const bool is_there = column + dx >= 0 && column + dx < size.n_x && row + dy >= 0 && row + dy < size.n_y;
      near.push_back(static_cast<int16_t>(is_there ? i + dy * size.n_x + dx : -1));
    }
  }
  std::vector<int32_t> sink(577);
  std::vector<int32_t> press(577);
  for (size_t i = 0; i < sink.size(); ++i) {
    const double u = std::log1p(std::max(static_cast<double>(i) / 64 - 1, -0.95));
    sink[i] = static_cast<int32_t>(std::lround(4'096 * u));
    press[i] = static_cast<int32_t>(std::lround(u > 0 ? 200'000 * u * u : 0));
  }
  std::vector<int16_t> reach;
  for (int y = 0; y < 20; ++y) {
    for (int x = 0; x < 20; ++x) reach.push_back(static_cast<int16_t>(16'384 * std::exp(-std::hypot(x, y) / 2.4)));
  }
  const auto filled = [n](int per, int32_t value) { return std::vector<int32_t>(static_cast<size_t>(n * per), value); };
  CalibrationBytes file;
  file.meta("kinds", "relaxation,skin")
      .meta("board", board.name)
      .meta("optics", board.camera.optics)
      .meta("resolution", std::to_string(board.camera.width_px) + "x" + std::to_string(board.camera.height_px))
      .meta("sensor_serial", "*")
      .meta("gel_serial", "*")
      .meta("created_utc", "2026-11-21T00:00:00Z")
      .meta("relaxation.terms", "2");
  const std::pair<const char*, int64_t> numbers[] = {{"taxels", n},
                                                     {"patches", 0},
                                                     {"runs", static_cast<int64_t>(runs.size() / 3)},
                                                     {"reach_step_um", pitch_um / 4},
                                                     {"taxel_area_um2", pitch_um * pitch_um},
                                                     {"floor_q12", 82},
                                                     {"apart_q12", 1'400},
                                                     {"pair_q12", 8'000},
                                                     {"sigma_un", 50'000},
                                                     {"sigma_q12", 300},
                                                     {"place_sigma_um", 400},
                                                     {"faint_place_sigma_um", 900},
                                                     {"stray_limit_q6", 32}};
  for (const auto& [key, value] : numbers) file.meta(std::string("skin.") + key, std::to_string(value));
  return file.tensor("skin.run", "I32", {static_cast<int>(runs.size() / 3), 3}, runs)
      .tensor("skin.light", "I32", {n}, filled(1, 4 * 2 * 40 * kOpeningPx * kOpeningPx))
      .tensor("skin.sink", "I32", {577}, sink)
      .tensor("skin.press", "I32", {577}, press)
      .tensor("skin.taxel_place", "I32", {n, 2}, places)
      .tensor("skin.gain", "I32", {1, 6, 9, 9}, std::vector<int32_t>(size_t{6} * 9 * 9, 65'536))
      .tensor("skin.taxel_shift", "I32", {n, 2, 4}, filled(8, 20'000))
      .tensor("relaxation.part", "I32", {2}, std::vector<int32_t>{150'000, 90'000})
      .tensor("relaxation.time_ms", "I32", {2}, std::vector<int32_t>{80, 4'000})
      .tensor("skin.reach", "I16", {20, 20}, reach)
      .tensor("skin.taxel_near", "I16", {n, 8}, near)
      .tensor("skin.taxel_kind", "I16", {n}, std::vector<int16_t>(static_cast<size_t>(n)))
      .bytes();
}

}  // namespace ruffini::test
