// Arrays of a frame that the C interface lists: slot, type, shape and unit of each.
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
  const char* type;     // numpy's name: u1, i2, i4, i8, u8
  const char* unit;     // of one step
  const char* columns;  // names for the last axis, if its columns are different quantities; else empty
  ArrayShape (*shape)(const FramePath& path);
  // Copies the array. Returns the number of valid rows along the first axis.
  size_t (*copy)(FramePath& path, void* out);
  // Reason why the last frame has no value for it, or empty.
  const char* (*absence)(FramePath& path) = [](FramePath&) { return ""; };
  // Of arrays whose unit depends on the stage that writes them: in place of `unit`
  const char* (*unit_of)(const FramePath& path) = nullptr;

  [[nodiscard]] size_t value_bytes() const { return static_cast<size_t>(type[1] - '0'); }
};

// All arrays of all boards. An array is available if a stage of the board writes its slot.
[[nodiscard]] std::span<const SlotView> slot_views();

}  // namespace ruffini
