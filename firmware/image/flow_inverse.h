// Inverse matrix that converts the misfit of a patch to a displacement, with its own scale.
#pragma once

#include <array>
#include <cstdint>

namespace ruffini {

struct FlowInverse {
  std::array<int32_t, 4> k{};  // xx xy yx yy, |k| < 2^30
  int shift = 0;               // from k times the misfit to Q16 px, at least 17; 0: no inverse
};

// Inverts a = sum h g^T over a patch (xx, xy, yx, yy, below 2^30). There is no inverse if det / trace is below `least`.
[[nodiscard]] FlowInverse invert_flow(const std::array<int64_t, 4>& a, int64_t least);

}  // namespace ruffini
