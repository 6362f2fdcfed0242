// Boards with a calibration, and what their camera sees at rest and pressed.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "support/dot_picture.h"
#include "support/glowing_skin.h"
#include "support/test_board.h"
#include "support/test_calibration.h"
#include "support/texture_calibration.h"

namespace ruffini::test {

struct Scene {
  BoardSettings board;
  std::vector<uint8_t> calibration;
  std::vector<uint8_t> rest;
  std::vector<uint8_t> pressed;
};

// Dots at rest, then moved and coloured.
inline Scene dots() {
  Scene scene{.board = round_board(), .calibration = {}, .rest = {}, .pressed = {}};
  scene.board.stages = stages_but({});
  scene.calibration = diagonal_calibration(scene.board);
  auto dots = nominal_dots(scene.board);
  scene.rest = DotPicture{}.bgr(dots, 1);
  for (Place& p : dots) p.x += 2;
  scene.pressed = DotPicture{}.bgr(dots, 2);
  const int width = scene.board.camera.width_px;
  const int height = scene.board.camera.height_px;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const int dx = x - width / 2;
      const int dy = y - height / 2;
      if (dx * dx + dy * dy > height * height / 16) continue;
      uint8_t* pixel = &scene.pressed[static_cast<size_t>((y * width + x) * 3)];
      pixel[0] = static_cast<uint8_t>(std::clamp(pixel[0] + dx, 0, 255));
      pixel[1] = static_cast<uint8_t>(std::clamp(pixel[1] + dy, 0, 255));
    }
  }
  return scene;
}

// Openings that glow, two of them more where the skin is touched.
inline Scene glow() {
  const BoardSettings board = glowing_board();
  return {.board = board,
          .calibration = skin_calibration(board),
          .rest = glowing_picture(board, {}, 0),
          .pressed = glowing_picture(board, {20, 51}, 2)};
}

// Ends of fibres on black, the first half of them brighter where the pad is pressed.
inline Scene spots() {
  Scene scene{.board = round_board(), .calibration = {}, .rest = {}, .pressed = {}};
  scene.board.markers.polarity = Polarity::kLight;
  scene.board.stages = {"difference", "spot_intensities"};
  scene.calibration = diagonal_calibration(scene.board);
  const int width = scene.board.camera.width_px;
  scene.rest.resize(static_cast<size_t>(3 * width * scene.board.camera.height_px));
  scene.pressed = scene.rest;
  const auto places = nominal_dots(scene.board);
  for (size_t k = 0; k < places.size(); ++k) {
    for (int y = -4; y <= 4; ++y) {
      for (int x = -4; x <= 4; ++x) {
        const int pixel = (static_cast<int>(places[k].y) + y) * width + static_cast<int>(places[k].x) + x;
        std::fill_n(scene.rest.begin() + 3 * pixel, 3, uint8_t{100});
        std::fill_n(scene.pressed.begin() + 3 * pixel, 3, static_cast<uint8_t>(2 * k < places.size() ? 140 : 100));
      }
    }
  }
  return scene;
}

// A texture that is pressed apart.
inline Scene texture() {
  const BoardSettings board = contact_board();
  return {.board = board,
          .calibration = contact_calibration(board),
          .rest = speckles(board, 0),
          .pressed = speckles(board, 1.5)};
}

}  // namespace ruffini::test
