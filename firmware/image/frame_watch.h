// Checks whether a live camera's frame is an intact picture, before any stage uses it.
//
//   samples: pairs of adjacent pixels, about every 16 px of every row; for row y
//   level(y)  = sum of B + G + R over its samples,    rough(y) = sum of |left - right| of B + G + R
//   broken:   a row whose difference from rest deviates from the previous row's by more than a quarter of rest plus 8
//             grey levels (a row or half a frame is missing); or 16 consecutive rows rougher than twice the roughest 16
//             of rest plus noise of 12 grey levels (a burst); or a column of some 40 rows that deviates from the
//             previous one by more than half of rest plus 8 grey levels (a column or a side is missing; presses on the
//             twin reach 0.47 of that)
//   light wrong: mean of a channel below half or above twice that of rest; only of channels above 16 grey levels at
//             rest
//   level off: the mean of all channels differs from rest by more than a quarter. A press on a fingertip changes it by
//             at most 1 % on the twin; an offset of 26 grey levels, which moves the pins' centroids, by 58 %
//
// The samples are 12 to 20 px apart without a period, so that rows of dots do not align with them.
//
// Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

class FrameWatch {
 public:
  struct Defects {
    bool is_broken = false;
    bool is_light_wrong = false;
    bool is_level_off = false;
  };

  FrameWatch(int width_px, int height_px);

  // Sets a new rest image, width x height x 3 in 1/16 grey levels.
  void learn(std::span<const uint16_t> rest);
  // Precondition: learn() was called.
  [[nodiscard]] Defects run(const FrameView& frame);

 private:
  struct Row {
    int32_t level = 0;
    int32_t rough = 0;
  };
  [[nodiscard]] bool is_broken() const;
  void add_columns(const FrameView& frame);
  [[nodiscard]] bool has_broken_column() const;

  int width_px_;
  std::vector<int32_t> at_;           // first pixel of each sample of a row
  std::vector<int> rows_;             // rows whose pixels form the columns
  std::vector<uint16_t> column_sum_;  // of the current frame, per channel
  std::vector<int32_t> column_rest_;  // B + G + R
  std::vector<Row> rest_;
  std::vector<Row> now_;
  std::array<int64_t, 3> rest_channel_{};
  int64_t max_rough_ = 0;  // of 16 rows of rest
};

}  // namespace ruffini
