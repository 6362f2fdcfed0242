// A Motion-JPEG frame of a camera as B, G, R. Any bytes may come: what is not one whole frame of the wanted size is no
// frame. Decoding is libjpeg-turbo's, with its accurate integer transform.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

namespace ruffini {

class JpegDecoder {
 public:
  JpegDecoder();
  JpegDecoder(const JpegDecoder&) = delete;
  JpegDecoder& operator=(const JpegDecoder&) = delete;
  ~JpegDecoder();

  // Writes 3 width height bytes to `out`; false: damaged, cut short, progressive, or of another size, and what `out`
  // holds means nothing. The library allocates some memory for each frame. Capture thread.
  [[nodiscard]] bool decode(const uint8_t* data, size_t n_bytes, int width, int height, uint8_t* out);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace ruffini
