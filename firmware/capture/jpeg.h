// Decodes a Motion-JPEG frame to B, G, R. The input is untrusted: anything but one complete frame of the expected size
// is rejected. Uses libjpeg-turbo with its accurate integer transform.
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

  // Writes 3 width height bytes to `out`. Returns false if the frame is damaged, truncated, progressive, or of another
  // size; `out` is undefined then. The library allocates some memory for each frame. Capture thread.
  [[nodiscard]] bool decode(const uint8_t* data, size_t n_bytes, int width, int height, uint8_t* out);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace ruffini
