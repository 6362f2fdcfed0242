// Which components of a node's displacement come from its neighbours, because its own were lost.
#pragma once

#include <cstdint>

namespace ruffini {

inline constexpr uint8_t kNothingFilled = 0;
inline constexpr uint8_t kShearFilled = 1;  // x and y
inline constexpr uint8_t kAllFilled = 2;

}  // namespace ruffini
