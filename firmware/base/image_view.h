// A non-owning view of rows of pixels; the owner outlives it.
#pragma once

#include <cstddef>
#include <cstdint>

namespace ruffini {

template <typename T>
struct ImageView {
  T* data = nullptr;
  int width = 0;         // pixels
  int height = 0;        // pixels
  int channels = 1;      // interleaved
  ptrdiff_t stride = 0;  // elements of T from one row to the next

  [[nodiscard]] T* row(int y) const { return data + y * stride; }
};

using FrameView = ImageView<const uint8_t>;  // B, G, R

// Integer size of a grid.
struct GridSize {
  int n_x = 0;
  int n_y = 0;
  [[nodiscard]] int count() const { return n_x * n_y; }
  bool operator==(const GridSize&) const = default;
};

}  // namespace ruffini
