// libFuzzer: any bytes as a camera's Motion-JPEG frame. What is taken is decoded the same again.
#include <algorithm>
#include <vector>

#include "capture/jpeg.h"
#include "device.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  constexpr int kWidth = 32;  // make_corpus.py's JPEG_SIZE
  constexpr int kHeight = 24;
  constexpr size_t kBytes = 3 * kWidth * kHeight;
  static ruffini::JpegDecoder decoder;
  std::vector<uint8_t> picture(kBytes);
  if (!decoder.decode(data, size, kWidth, kHeight, picture.data())) return 0;
  std::vector<uint8_t> again(kBytes, uint8_t{0xaa});
  ruffini::fuzz::expect(decoder.decode(data, size, kWidth, kHeight, again.data()), "a whole frame is whole");
  ruffini::fuzz::expect(std::ranges::equal(picture, again), "every pixel of a whole frame is written, each time alike");
  return 0;
}
