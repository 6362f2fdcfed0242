// Decodes a Motion-JPEG frame or a JPEG file to B, G, R. The input is untrusted: anything but one complete frame of the
// expected size is rejected. Uses libjpeg-turbo with its accurate integer transform.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>

namespace ruffini {

class JpegDecoder {
 public:
  // A camera sends one scan. With many scans, as in progressive files, a few bytes could demand minutes of work: kAny
  // takes up to 100, ten times what programs write.
  enum class Scans { kOne, kAny };
  explicit JpegDecoder(Scans scans = Scans::kOne);
  JpegDecoder(const JpegDecoder&) = delete;
  JpegDecoder& operator=(const JpegDecoder&) = delete;
  ~JpegDecoder();

  // Writes 3 width height bytes to `out`. Returns false if the frame is damaged, truncated, of another size, or has
  // more scans than wanted; `out` is undefined then. The library allocates some memory for each frame. Capture thread.
  [[nodiscard]] bool decode(const uint8_t* data, size_t n_bytes, int width, int height, uint8_t* out);

  // Width and height as the header has them; 0 and 0 if it cannot be read.
  [[nodiscard]] std::pair<int, int> read_size(const uint8_t* data, size_t n_bytes);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace ruffini
