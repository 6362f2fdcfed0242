// Rest as it was last known to be that of an untouched pad, in the store's folder: what a start is compared with.
//
//   "RREST1\0\0", width and height (u32), then width x height x 3 values of 1/16 grey level (u16), CRC-32C of all before
//   (u32); all little-endian. Written as a new file that takes the old one's name.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/result.h"
#include "store/storage.h"

namespace ruffini {

// Empty where there is none, or none of this size that is whole.
[[nodiscard]] std::vector<uint16_t> load_rest(const Storage& medium, int width_px, int height_px);

// Errors: kStorage; what was there stays then.
[[nodiscard]] Status save_rest(Storage& medium, std::span<const uint16_t> rest, int width_px, int height_px);

}  // namespace ruffini
