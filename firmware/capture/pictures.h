// Pictures of a recording, and the door of libruffini_pictures.so, which decodes them: a library of its own, loaded
// where a recording is played. What reads picture and video files pulls in over two hundred other libraries.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>

namespace ruffini {

// B G R, row by row; valid until the next one is asked for.
struct Picture {
  int width_px = 0;
  int height_px = 0;
  const uint8_t* pixels = nullptr;
  ptrdiff_t row_bytes = 0;
};

class Pictures {
 public:
  virtual ~Pictures() = default;
  // nullopt is the end; what cannot be read is a Picture of 0 x 0. Throws nothing.
  virtual std::optional<Picture> next() = 0;
  virtual void rewind() = 0;
  // As the file states it; 0 or nonsense where it does not.
  [[nodiscard]] virtual double rate_hz() const = 0;
};

inline constexpr const char* kPicturesLibrary = "libruffini_pictures.so";
inline constexpr const char* kPicturesOpener = "ruffini_open_pictures";

// Of a video, or of a folder of images, sorted by name. The caller owns what is returned; nullptr where there is none.
using PicturesOpener = Pictures*(const char* path);

}  // namespace ruffini
