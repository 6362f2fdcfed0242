// Weights of the nearest scattered markers at one place: moving least squares by a polynomial of order 2.
//
//   K = 16 nearest markers (or one fewer than there are), R the distance of the next one
//   (x, y) = (X_k - X) / R,  t = x^2 + y^2,  w = (1 - t)^2 / (t + 1/50),  b = (1, x, y, x^2, x y, y^2)
//   G = sum w b b^T / sum w + diag(0, e, e, 10 e, 10 e, 10 e),  e = 1e-4
//   weight_k = w_k / (sum w)  b_k . G^-1 (1, 0, 0, 0, 0, 0)
//
// The small diagonal makes curvature, then slope, go to zero if the markers do not determine it; what it and rounding
// take from the sum goes to the nearest marker. Fixed point: b Q12, w Q16, G Q26, the column of its inverse Q20,
// weights Q28. Bounds: |1/G| <= 1e4 < 2^14, so all products stay below 2^62.
#pragma once

#include <span>

#include "image/marker_interpolation.h"

namespace ruffini {

[[nodiscard]] MarkerWeights scattered_weights(const PadPoint& place, std::span<const PadPoint> rest,
                                              std::span<const Marker> markers);

}  // namespace ruffini
