// What four parts of a picture have in common, where one of them may be disturbed by a contact.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

namespace ruffini {

// Size of the second smallest where at least three agree in sign, else 0.
[[nodiscard]] inline int64_t common_part(std::array<int64_t, 4> parts) {
  std::sort(parts.begin(), parts.end());
  if (parts[1] > 0) return parts[1];
  return parts[2] < 0 ? -parts[2] : 0;
}

}  // namespace ruffini
