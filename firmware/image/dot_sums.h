// Sums over one dot for dot_templates.h: luma around it, sampled between the pixels and multiplied by the dot's
// template.
//
//   luma  = (117 B + 601 G + 306 R + 32) >> 6                       of each pixel of a square window, at most 4,080
//   value = down(across(a, b), across(c, d)), both: a + (((b - a) share + 2^14) >> 15)
//
// Values are counted row after row, so that neighbours are 1 and `side` further on; those beyond a row's end mean
// nothing, and their template and `keep` are 0. Bounds: template and values are at most 2^12, and a lane of 8 adds at
// most 25 x 26 / 8 of their products: below 2^31. All versions give the same bits.
#pragma once

#include <cstddef>
#include <cstdint>

namespace ruffini {

struct DotWindow {
  static constexpr int kMaxRadiusPx = 12;
  static constexpr int kLanes = 16;  // values are counted in such blocks

  const uint8_t* pixels = nullptr;  // B, G, R of the first pixel
  ptrdiff_t stride = 0;
  int side = 0;
  int16_t share_x = 0;  // Q15, not negative
  int16_t share_y = 0;
  int n_values = 0;  // a multiple of kLanes
  const int16_t* h_x = nullptr;
  const int16_t* h_y = nullptr;
  const int16_t* t = nullptr;
  const int16_t* keep = nullptr;  // -1 in the dot's disc
  int16_t* luma = nullptr;        // room for n_values + side + 1
};

struct DotSums {
  int64_t h_x = 0;
  int64_t h_y = 0;
  int64_t sum = 0;
  int64_t square = 0;
  int64_t common = 0;  // with t
  bool operator==(const DotSums&) const = default;
};
using DotSumsRun = DotSums (*)(const DotWindow& window);

inline constexpr int kLumaLanes = 8;  // pixels at a time

// Luma of a window whose side is at least kLumaLanes: `eight` makes that of the eight pixels that begin at its first
// argument. A row's last eight overlap those before, so that no byte beyond the row is read.
template <typename Eight>
void make_luma(const DotWindow& window, Eight eight) {
  for (int row = 0; row < window.side; ++row) {
    const uint8_t* at = window.pixels + row * window.stride;
    int16_t* out = window.luma + ptrdiff_t{row} * window.side;
    for (int x = 0; x < window.side; x += kLumaLanes) {
      const int from = x + kLumaLanes <= window.side ? x : window.side - kLumaLanes;
      eight(at + ptrdiff_t{3} * from, out + from);
    }
  }
}

// The reference. Not inline: a copy compiled for AVX2 must not take its place.
DotSums dot_sums_scalar(const DotWindow& window);

}  // namespace ruffini
