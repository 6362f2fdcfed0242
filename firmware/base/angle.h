// Integer trigonometry.
#pragma once

#include <array>
#include <cstdint>

namespace ruffini {

// Returns the angle of (x, y) from the x axis, -pi to pi, in 1e-6 rad, computed by CORDIC. The error is at most 2e-6
// rad if |x| or |y| exceeds 2^18. Precondition: |x|, |y| < 2^36. The angle of (0, 0) is 0.
[[nodiscard]] constexpr int64_t atan2_urad(int64_t y, int64_t x) {
  // atan 2^-i in 1e-9 rad.
  constexpr std::array<int64_t, 22> kAngle = {
      785398163, 463647609, 244978663, 124354995, 62418810, 31239833, 15623729, 7812341, 3906230, 1953123, 976562,
      488281,    244141,    122070,    61035,     30518,    15259,    7629,     3815,    1907,    954,     477};
  constexpr int64_t kPi = 3'141'592'654;
  if (x == 0 && y == 0) return 0;
  int64_t angle = 0;
  if (x < 0) {
    angle = y < 0 ? -kPi : kPi;
    x = -x;
    y = -y;
  }
  x *= 1024;
  y *= 1024;
  for (size_t i = 0; i < kAngle.size(); ++i) {
    const int64_t dx = x >> i, dy = y >> i;
    if (y > 0) {
      x += dy;
      y -= dx;
      angle += kAngle[i];
    } else {
      x -= dy;
      y += dx;
      angle -= kAngle[i];
    }
  }
  return (angle + 500) / 1000 - (((angle + 500) % 1000) < 0 ? 1 : 0);
}

}  // namespace ruffini
