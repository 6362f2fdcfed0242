// Tables of the kind `photometric` of a calibration, as views into it (shapes: proto/CALIBRATION.md).
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "base/image_view.h"
#include "base/result.h"
#include "store/calibration.h"

namespace ruffini {

struct PhotometricTable {
  static constexpr int kSlopeSize = 65;
  static constexpr int kBendSize = 9;
  static constexpr int kDepthSize = 257;

  // Returns kBadInput if a tensor is missing or has a wrong shape or range.
  [[nodiscard]] static Result<PhotometricTable> load(const Calibration& calibration);

  std::span<const int16_t> unmix;  // [n_cells_y][n_cells_x][2][3]
  GridSize cells;
  std::span<const int16_t> slope;         // [65][65][2]
  std::span<const int16_t> bend;          // [9][9][9][2], or empty
  std::array<int32_t, 3> bend_low_q12{};  // change of B, G, R at the first line
  std::array<int32_t, 3> bend_shift{};    // distance of two lines: 2^shift in Q12
  std::span<const int16_t> depth;         // [257], or empty: for skins that darken, instead of all tables above
  bool is_balanced = false;               // the level of a frame's light is used
};

}  // namespace ruffini
