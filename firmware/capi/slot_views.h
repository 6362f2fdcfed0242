// The arrays of a frame that the C interface lists: which slot each shows, its type, shape and unit.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "frame_path.h"

namespace ruffini {

struct ArrayShape {
  int n_axes = 1;
  std::array<size_t, 3> size{1, 1, 1};

  [[nodiscard]] size_t count() const { return size[0] * size[1] * size[2]; }
};

struct SlotView {
  const char* name;
  Slot slot;
  const char* type;     // as numpy names it: u1, i2, i4, i8, u8
  const char* unit;     // of one step
  const char* columns;  // of the last axis, where each is a quantity of its own; else empty
  ArrayShape (*shape)(const FramePath& path);
  // Copies the array; returns how many rows of the first axis are valid.
  size_t (*copy)(FramePath& path, void* out);
  // Why the last frame has none of it, or empty.
  const char* (*absence)(FramePath& path) = [](FramePath&) { return ""; };

  [[nodiscard]] size_t value_bytes() const { return static_cast<size_t>(type[1] - '0'); }
};

// Of every board; one of these is there if a stage of the board writes its slot.
[[nodiscard]] std::span<const SlotView> slot_views();

}  // namespace ruffini
