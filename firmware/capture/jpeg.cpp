#include "capture/jpeg.h"

#include <csetjmp>
#include <cstdio>
// jpeglib.h requires size_t and FILE from the headers above.
#include <jerror.h>
#include <jpeglib.h>

namespace ruffini {

// The library leaves errors by longjmp: no C++ object with a destructor may exist between it and decode_rows.
struct JpegDecoder::State {
  static constexpr int kMaxScans = 100;
  jpeg_decompress_struct image{};
  jpeg_error_mgr errors{};
  jpeg_progress_mgr progress{};
  std::jmp_buf way_out{};
  Scans scans = Scans::kOne;
  bool is_damaged = false;

  static State& of(j_common_ptr image) { return *static_cast<State*>(image->client_data); }

  [[noreturn]] static void fail(j_common_ptr image) { std::longjmp(of(image).way_out, 1); }

  // Level -1 is damage that the library conceals, except extra bytes after a complete picture, which some cameras
  // append.
  static void warn(j_common_ptr image, int level) {
    constexpr int kEndOfImage = 0xd9;
    if (level >= 0) return;
    const jpeg_error_mgr& errors = of(image).errors;
    const bool is_filling = errors.msg_code == JWRN_EXTRANEOUS_DATA && errors.msg_parm.i[1] == kEndOfImage;
    if (!is_filling) of(image).is_damaged = true;
  }

  // Called often while a picture is decoded.
  static void look(j_common_ptr image) {
    if (of(image).image.input_scan_number > kMaxScans) fail(image);
  }

  // The library keeps the tables of one picture for the next: each frame has a decompressor of its own.
  void begin() {
    image = {};
    image.err = jpeg_std_error(&errors);
    errors.error_exit = fail;
    errors.emit_message = warn;
    errors.output_message = [](j_common_ptr) {};
    progress.progress_monitor = look;
    image.client_data = this;
    is_damaged = false;
  }

  std::pair<int, int> read_size(const uint8_t* data, size_t n_bytes) {
    begin();
    if (setjmp(way_out) != 0) {  // NOLINT(cert-err52-cpp): libjpeg has no other way
      jpeg_destroy_decompress(&image);
      return {0, 0};
    }
    jpeg_create_decompress(&image);
    jpeg_mem_src(&image, data, n_bytes);
    jpeg_read_header(&image, TRUE);
    jpeg_destroy_decompress(&image);
    return {static_cast<int>(image.image_width), static_cast<int>(image.image_height)};
  }

  bool decode_rows(const uint8_t* data, size_t n_bytes, int width, int height, uint8_t* out) {
    begin();
    if (setjmp(way_out) != 0) {  // NOLINT(cert-err52-cpp): libjpeg has no other way
      jpeg_destroy_decompress(&image);
      return false;
    }
    jpeg_create_decompress(&image);
    image.progress = &progress;
    jpeg_mem_src(&image, data, n_bytes);
    jpeg_read_header(&image, TRUE);
    const bool is_wanted = image.image_width == static_cast<JDIMENSION>(width) &&
                           image.image_height == static_cast<JDIMENSION>(height) &&
                           (scans == Scans::kAny || jpeg_has_multiple_scans(&image) == 0);
    if (!is_wanted) {
      jpeg_destroy_decompress(&image);
      return false;
    }
    image.out_color_space = JCS_EXT_BGR;
    image.dct_method = JDCT_ISLOW;
    jpeg_start_decompress(&image);
    while (image.output_scanline < image.output_height && !is_damaged) {
      JSAMPROW row = out + size_t{3} * image.output_width * image.output_scanline;
      jpeg_read_scanlines(&image, &row, 1);
    }
    if (!is_damaged) jpeg_finish_decompress(&image);
    jpeg_destroy_decompress(&image);
    return !is_damaged;
  }
};

JpegDecoder::JpegDecoder(Scans scans) : state_(std::make_unique<State>()) { state_->scans = scans; }

JpegDecoder::~JpegDecoder() = default;

bool JpegDecoder::decode(const uint8_t* data, size_t n_bytes, int width, int height, uint8_t* out) {
  return n_bytes > 0 && state_->decode_rows(data, n_bytes, width, height, out);
}

std::pair<int, int> JpegDecoder::read_size(const uint8_t* data, size_t n_bytes) {
  return n_bytes > 0 ? state_->read_size(data, n_bytes) : std::pair(0, 0);
}

}  // namespace ruffini
