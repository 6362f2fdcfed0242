#include "capture/png.h"

#include <png.h>

#include <algorithm>
#include <csetjmp>

namespace ruffini {
namespace {

constexpr png_uint_32 kMaxSidePx = 1 << 16;
constexpr png_alloc_size_t kMaxChunkBytes = 1 << 20;  // of text and colour profiles, which may be compressed

void read_bytes(png_structp png, png_bytep to, size_t n_bytes) {
  auto& rest = *static_cast<std::span<const uint8_t>*>(png_get_io_ptr(png));
  if (n_bytes > rest.size()) png_error(png, "truncated");
  std::copy_n(rest.data(), n_bytes, to);
  rest = rest.subspan(n_bytes);
}

[[noreturn]] void fail(png_structp png, png_const_charp) { png_longjmp(png, 1); }

void ignore(png_structp, png_const_charp) {}

void ask_for_bgr(png_structp png, png_infop info) {
  const png_byte colour = png_get_color_type(png, info);
  png_set_strip_16(png);
  png_set_strip_alpha(png);
  if (colour == PNG_COLOR_TYPE_PALETTE) png_set_palette_to_rgb(png);
  if (colour == PNG_COLOR_TYPE_GRAY) png_set_expand_gray_1_2_4_to_8(png);
  if ((colour & PNG_COLOR_MASK_COLOR) != 0) {
    png_set_bgr(png);
  } else {
    png_set_gray_to_rgb(png);
  }
}

// The library leaves errors by longjmp: no C++ object with a destructor may exist between it and this function.
PngSize decode_with(png_structp png, png_infop info, std::span<const uint8_t>& rest, size_t max_pixels,
                    std::vector<uint8_t>& out) {
  if (setjmp(png_jmpbuf(png)) != 0) return {};  // NOLINT(cert-err52-cpp): libpng has no other way
  png_set_user_limits(png, kMaxSidePx, kMaxSidePx);
  png_set_chunk_malloc_max(png, kMaxChunkBytes);
  png_set_read_fn(png, &rest, read_bytes);
  png_read_info(png, info);
  const size_t width = png_get_image_width(png, info);
  const size_t height = png_get_image_height(png, info);
  if (width * height > max_pixels) return {};
  ask_for_bgr(png, info);
  const int n_passes = png_set_interlace_handling(png);
  png_read_update_info(png, info);
  if (png_get_rowbytes(png, info) != 3 * width) return {};
  out.resize(3 * width * height);
  for (int pass = 0; pass < n_passes; ++pass) {
    for (size_t y = 0; y < height; ++y) png_read_row(png, out.data() + 3 * width * y, nullptr);
  }
  png_read_end(png, nullptr);
  return {static_cast<int>(width), static_cast<int>(height)};
}

}  // namespace

PngSize decode_png(std::span<const uint8_t> file, size_t max_pixels, std::vector<uint8_t>& out) {
  png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, nullptr, fail, ignore);
  if (png == nullptr) return {};
  png_infop info = png_create_info_struct(png);
  const PngSize size = info == nullptr ? PngSize{} : decode_with(png, info, file, max_pixels, out);
  png_destroy_read_struct(&png, &info, nullptr);
  return size;
}

}  // namespace ruffini
