// Removes ambient light from a picture: lit minus dark, per pixel and channel, never below 0. Values that are saturated
// in the lit picture stay saturated, because the true level is unknown.
#pragma once

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <span>

namespace ruffini {

// lit[i] = 255 if it is 255, else max(lit[i] - dark[i], 0). Precondition: both spans have the same length.
inline void take_ambient_away(std::span<uint8_t> lit, std::span<const uint8_t> dark) {
  assert(lit.size() == dark.size());
  uint8_t* const out = lit.data();
  const uint8_t* const less = dark.data();
  const size_t n = lit.size();
  for (size_t i = 0; i < n; ++i) {
    const uint8_t ambient = out[i] == UINT8_MAX ? uint8_t{0} : std::min(out[i], less[i]);
    out[i] = static_cast<uint8_t>(out[i] - ambient);
  }
}

}  // namespace ruffini
