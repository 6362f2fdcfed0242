// The last verified rest image, stored in the store's folder; a start is compared with it.
//
//   "RREST1\0\0", width and height (u32), then width x height x 3 values of 1/16 grey level (u16), CRC-32C of all
//   before (u32); all little-endian. Written to a new file, which is then renamed over the old one.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/result.h"
#include "store/storage.h"

namespace ruffini {

// Returns an empty vector if there is no intact image of this size.
[[nodiscard]] std::vector<uint16_t> load_rest(const Storage& medium, int width_px, int height_px);

// Errors: kStorage; the previous image remains then.
[[nodiscard]] Status save_rest(Storage& medium, std::span<const uint16_t> rest, int width_px, int height_px);

}  // namespace ruffini
