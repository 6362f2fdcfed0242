// Decodes a PNG file to B, G, R with libpng. The input is untrusted: a damaged or truncated file is rejected. 16 bits
// are cut to 8, grey becomes three equal colours, and transparency is dropped, as OpenCV's imread does.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace ruffini {

struct PngSize {
  int width_px = 0;
  int height_px = 0;
};

// Fills `out` with 3 width height bytes. Returns 0 x 0 if the file is no complete PNG or has more than `max_pixels`.
[[nodiscard]] PngSize decode_png(std::span<const uint8_t> file, size_t max_pixels, std::vector<uint8_t>& out);

}  // namespace ruffini
