// Pictures of a recording, and the entry point of libruffini_pictures.so, which decodes videos and the images that are
// neither PNG nor JPEG. It is a separate library, loaded only for those, because it depends on over two hundred
// libraries.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>

namespace ruffini {

// B G R, row by row; valid until the next call of next().
struct Picture {
  int width_px = 0;
  int height_px = 0;
  const uint8_t* pixels = nullptr;
  ptrdiff_t row_bytes = 0;
};

class Pictures {
 public:
  virtual ~Pictures() = default;
  // Returns nullopt at the end, and a Picture of 0 x 0 for an unreadable file. Does not throw.
  virtual std::optional<Picture> next() = 0;
  virtual void rewind() = 0;
  // Rate stated by the file; 0 or an arbitrary value if it states none.
  [[nodiscard]] virtual double rate_hz() const = 0;
};

inline constexpr const char* kPicturesLibrary = "libruffini_pictures.so";
inline constexpr const char* kPicturesOpener = "ruffini_open_pictures";

// Opens a video or one image. The caller owns the result; nullptr if there are no pictures.
using PicturesOpener = Pictures*(const char* path);

}  // namespace ruffini
