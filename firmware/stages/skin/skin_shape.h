// Converts a position on the unrolled skin to three dimensions, with the outward normal.
//
//   plane   (x, y, 0), out = (0, 0, 1)
//   tube    about z: angle a = x / R from the x axis: (R cos a, R sin a, y), out = (cos a, sin a, 0)
//   dome    top at the origin: s = |(x, y)|, angle a = s / R: out = (x/s sin a, y/s sin a, cos a), R out - (0, 0, R)
//
// Cosines in Q30; pi R is rounded to a micrometre. Frame thread; no allocation.
#pragma once

#include <array>
#include <cstdint>

#include "board/settings.h"

namespace ruffini {

struct SkinPoint {
  std::array<int64_t, 3> place_um{};
  std::array<int64_t, 3> out_q30{};
};

[[nodiscard]] SkinPoint on_skin(const SkinSettings& skin, int64_t x_um, int64_t y_um);

// A pressing force as a vector: along the normal, into the skin.
[[nodiscard]] std::array<int64_t, 3> pressing_vector_un(const SkinPoint& point, int64_t press_un);

}  // namespace ruffini
