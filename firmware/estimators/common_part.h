// Magnitude that most of four parts of a picture share, although a contact may disturb one of them.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

namespace ruffini {

// Returns the second smallest magnitude if at least three parts agree in sign, else 0.
[[nodiscard]] inline int64_t common_part(std::array<int64_t, 4> parts) {
  std::sort(parts.begin(), parts.end());
  if (parts[1] > 0) return parts[1];
  return parts[2] < 0 ? -parts[2] : 0;
}

}  // namespace ruffini
