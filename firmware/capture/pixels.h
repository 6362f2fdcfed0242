// Converts a camera's pixels to the kernels' layout: B, G, R, row by row without gaps. Integers only.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace ruffini {

// In memory byte order. kYuyv: Y0 U Y1 V. kNv12: a plane of Y, then one of U V with half the size.
enum class PixelLayout { kBgr, kRgb, kBgrx, kYuyv, kNv12, kGrey };

// Conversion from Y U V to B G R. B = gain (Y - black) + u_to_b (U - 128), G and R likewise; in steps of 1/16384.
struct YuvRule {
  int32_t black;
  int32_t gain;
  int32_t v_to_r;
  int32_t u_to_g;
  int32_t v_to_g;
  int32_t u_to_b;
};
// ITU-R BT.601 and BT.709; full range: 0 to 255, limited: 16 to 235 (U and V to 240).
inline constexpr YuvRule kFull601 = {0, 16'384, 22'970, -5'638, -11'700, 29'032};
inline constexpr YuvRule kLimited601 = {16, 19'077, 26'149, -6'419, -13'320, 33'050};
inline constexpr YuvRule kFull709 = {0, 16'384, 25'802, -3'069, -7'670, 30'402};
inline constexpr YuvRule kLimited709 = {16, 19'077, 29'372, -3'494, -8'731, 34'610};

// First byte and row stride of each plane; the second plane exists only for kNv12.
struct RawFrame {
  std::array<const uint8_t*, 2> planes{};
  std::array<ptrdiff_t, 2> strides{};
};

// `out` has room for 3 width height bytes. kYuyv and kNv12 need an even width, kNv12 an even height. Capture thread.
void to_bgr(PixelLayout layout, const YuvRule& rule, const RawFrame& frame, int width, int height, uint8_t* out);

}  // namespace ruffini
