// Pictures of printed dots with known centres: area coverage by 8 x 8 sub-samples, seeded noise.
#pragma once

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "board/settings.h"
#include "image/markers.h"

namespace ruffini::test {

struct Place {
  double x;
  double y;
};

struct DotPicture {
  int width = 160;
  int height = 120;
  double level = 120;     // of the background, per channel
  double gradient = 0.3;  // relative change of it over the width
  double contrast = 0.6;  // a dot reflects 1 - contrast of the background; negative = lighter
  double diameter_px = 6;
  double noise = 1;  // standard deviation, grey levels, per channel

  [[nodiscard]] double coverage(int x, int y, const Place& dot) const {
    constexpr int kSub = 8;
    int inside = 0;
    for (int j = 0; j < kSub; ++j) {
      for (int i = 0; i < kSub; ++i) {
        const double dx = x + (i + 0.5) / kSub - 0.5 - dot.x;
        const double dy = y + (j + 0.5) / kSub - 0.5 - dot.y;
        inside += static_cast<int>(dx * dx + dy * dy <= diameter_px * diameter_px / 4);
      }
    }
    return inside / static_cast<double>(kSub * kSub);
  }

  // B, G, R of one frame.
  [[nodiscard]] std::vector<uint8_t> bgr(const std::vector<Place>& dots, unsigned seed) const {
    std::vector<double> cover(static_cast<size_t>(width * height));
    for (const Place& dot : dots) {
      const int reach = static_cast<int>(diameter_px / 2) + 2;
      for (int y = std::max(static_cast<int>(dot.y) - reach, 0);
           y <= std::min(static_cast<int>(dot.y) + reach, height - 1); ++y) {
        for (int x = std::max(static_cast<int>(dot.x) - reach, 0);
             x <= std::min(static_cast<int>(dot.x) + reach, width - 1); ++x) {
          double& here = cover[static_cast<size_t>(y * width + x)];
          here = std::min(1.0, here + coverage(x, y, dot));
        }
      }
    }
    std::mt19937 random(seed);
    std::normal_distribution<double> normal(0, noise);
    std::vector<uint8_t> out;
    for (int i = 0; i < width * height; ++i) {
      const double shade = level * (1 + gradient * (i % width / static_cast<double>(width) - 0.5));
      for (int c = 0; c < 3; ++c) {
        const double value = shade * (1 - contrast * cover[static_cast<size_t>(i)]) + (noise > 0 ? normal(random) : 0);
        out.push_back(static_cast<uint8_t>(std::lround(std::min(std::max(value, 0.0), 255.0))));
      }
    }
    return out;
  }

  // B + G + R in 1/16 levels, as the detector takes it.
  [[nodiscard]] std::vector<uint16_t> grey(const std::vector<Place>& dots, unsigned seed) const {
    const std::vector<uint8_t> pixels = bgr(dots, seed);
    std::vector<uint16_t> out;
    for (size_t i = 0; i < pixels.size(); i += 3) {
      out.push_back(static_cast<uint16_t>(16 * (pixels[i] + pixels[i + 1] + pixels[i + 2])));
    }
    return out;
  }
};

// Where the board says its markers are, in the image of the untouched pad.
inline std::vector<Place> nominal_dots(const BoardSettings& board) {
  const MarkerSettings& m = board.markers;
  const double px_per_um =
      static_cast<double>(board.camera.focal_mpx) / 1000 / static_cast<double>(board.camera.standoff_um);
  std::vector<Place> out;
  for (int j = 0; j < m.lattice.n_y; ++j) {
    for (int i = 0; i < m.lattice.n_x; ++i) {
      const auto x_um = static_cast<double>(m.first_x_um + i * m.pitch_x_um - board.pad.size_x_um / 2);
      const auto y_um = static_cast<double>(m.first_y_um + j * m.pitch_y_um - board.pad.size_y_um / 2);
      out.push_back({static_cast<double>(board.camera.center_x_mpx) / 1000 + x_um * px_per_um,
                     static_cast<double>(board.camera.center_y_mpx) / 1000 + y_um * px_per_um});
    }
  }
  return out;
}

// Dots at exact places, as a perfect detector would report them.
inline std::vector<Dot> exact_dots(const std::vector<Place>& places) {
  std::vector<Dot> out;
  for (const Place& p : places) {
    out.push_back({ImagePx::from_raw(static_cast<int32_t>(std::lround(p.x * 65536))),
                   ImagePx::from_raw(static_cast<int32_t>(std::lround(p.y * 65536))), 28});
  }
  return out;
}

// Markers follow dots of which nothing is known against them. Number of markers lost.
inline int track(MarkerTracker& tracker, const std::vector<Dot>& dots) {
  const std::vector<int64_t> error2(tracker.assign(dots).size());
  return tracker.finish(error2);
}

}  // namespace ruffini::test
