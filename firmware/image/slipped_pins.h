// Detects displaced rows of a picture by scattered markers, which all jump together at the edge of such rows; as
// image/slipped_rows.h does for lattices.
//
//   above, below   of each marker: the nearest one within 45 degrees of the column and an eighth of the picture's
//                  height
//   jump(i)        d(below i) - d(i)        d: displacement, px
//   bend(i)        jump(i) - mean of jump(above i) and jump(below i), as far as these exist
//   slipped        at some line, each fourth one, along x or y, half of the pairs of i and below i that it separates
//                  bend
//                  to the same side by more than 0.2 px; at least kMinPairs pairs
//
// On the twin of a fingertip of two views, presses of up to 0.5 N make at most a third of the pairs bend so, a slip by
// a pixel more than half. Limit: rows that hold no marker. Frame thread; no allocation after the constructor but in
// learn(). Not in the papers.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "image/markers.h"

namespace ruffini {

class SlippedPins {
 public:
  explicit SlippedPins(int height_px);

  // Learns the markers at rest; `n_views` equal parts of them are of different views.
  void learn(std::span<const Marker> markers, size_t n_views);
  // True if rows have slipped.
  [[nodiscard]] bool run(std::span<const Marker> markers);

 private:
  static constexpr int kNone = -1;

  struct Line {
    int n = 0;
    std::array<int, 2> n_more{};  // along x, y
    std::array<int, 2> n_less{};
  };

  int64_t reach_q16_;
  std::vector<int> above_;
  std::vector<int> below_;
  std::vector<Line> lines_;  // what each adds to the counts of the one before; one more than there are lines
};

}  // namespace ruffini
