// Which markers are neighbours: by line and column of a lattice, or of scattered markers by where they rest.
//
//   lattice    beside: left, right, above, below; around: those and the diagonal ones; lines: two in a row, outwards
//   scattered  beside and around: j for i where the circle over i-j holds no third marker (Gabriel 1969), both ways;
//              line through j: the k beside j nearest to 2 r_j - r_i, where closer to it than |r_j - r_i| / 2
//
// A displacement d_i is foretold as the mean of 2 d_j - d_k over its lines, else of its neighbours' d.
// Laid at construction and when rest is learned; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

struct Marker;

// In the image, Q16 px.
struct ImagePoint {
  int64_t x = 0;
  int64_t y = 0;
};
[[nodiscard]] constexpr int64_t distance2(const ImagePoint& a, const ImagePoint& b) {
  return (a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y);
}

// The place nearest to the mean of those that `is_free` holds; it is free no longer.
int take_middle(std::span<const ImagePoint> places, std::span<uint8_t> is_free);

class MarkerGraph {
 public:
  static constexpr size_t kMaxNear = 8;
  struct Line {
    int near = 0;
    int far = 0;
  };

  // Neighbours on a lattice.
  explicit MarkerGraph(GridSize lattice);
  // Neighbours of scattered markers at `rest`, one place each; those not there have none. A marker keeps its eight
  // nearest.
  void connect(std::span<const ImagePoint> rest, std::span<const uint8_t> is_there);

  [[nodiscard]] std::span<const int> beside(size_t marker) const { return nodes_[marker].beside.view(); }
  [[nodiscard]] std::span<const int> around(size_t marker) const { return nodes_[marker].around.view(); }
  [[nodiscard]] std::span<const Line> lines(size_t marker) const { return nodes_[marker].lines.view(); }

  // Mean displacement, rounded down, of the markers around one that `known` holds; false = none.
  bool mean_around(std::span<const Marker> markers, std::span<const uint8_t> known, size_t marker,
                   ImagePoint& mean) const;
  // Mean of what the lines through two known neighbours say, rounded down; false = none.
  bool mean_on_lines(std::span<const Marker> markers, std::span<const uint8_t> known, size_t marker,
                     ImagePoint& mean) const;
  // Ring by ring, markers not known take the mean of those around them and are known in the next round. `known` ends as
  // ones wherever something known can be reached; `next` is work space of the same size.
  void fill(std::span<Marker> markers, std::vector<uint8_t>& known, std::vector<uint8_t>& next) const;

 private:
  template <typename T>
  struct Few {
    std::array<T, kMaxNear> item{};
    size_t n = 0;
    void add(const T& one) { item[n++] = one; }
    [[nodiscard]] std::span<const T> view() const { return {item.data(), n}; }
  };
  struct Node {
    Few<int> beside;
    Few<int> around;
    Few<Line> lines;
  };
  void find_nearest(std::span<const ImagePoint> rest, std::span<const uint8_t> is_there, size_t marker);
  void find_lines(std::span<const ImagePoint> rest, size_t marker);

  std::vector<Node> nodes_;
};

}  // namespace ruffini
