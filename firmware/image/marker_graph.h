// Neighbours of each marker: by row and column on a lattice, or by rest position for scattered markers.
//
//   lattice    beside: left, right, above, below; around: those and the diagonal ones; lines: two in a row, outwards
//   scattered  beside and around: i-j if the circle with diameter i-j contains no third marker (Gabriel 1969), both
//              ways; line through j: the k beside j nearest to 2 r_j - r_i, if closer to it than |r_j - r_i| / 2
//
// The displacement of a marker is predicted as the mean of 2 d_j - d_k over its lines or, without lines, as the mean of
// its neighbours' d. The graph is built at construction and when rest is learned; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

struct Marker;

// Position in the image, Q16 px.
struct ImagePoint {
  int64_t x = 0;
  int64_t y = 0;
};
[[nodiscard]] constexpr int64_t distance2(const ImagePoint& a, const ImagePoint& b) {
  return (a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y);
}

// Returns the place with `is_free` set that is nearest to the mean of all free places, and clears its is_free.
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
  // Connects scattered markers at `rest`, one position each; markers that are not there have no neighbours. A marker
  // keeps its eight nearest.
  void connect(std::span<const ImagePoint> rest, std::span<const uint8_t> is_there);

  [[nodiscard]] std::span<const int> beside(size_t marker) const { return nodes_[marker].beside.view(); }
  [[nodiscard]] std::span<const int> around(size_t marker) const { return nodes_[marker].around.view(); }
  [[nodiscard]] std::span<const Line> lines(size_t marker) const { return nodes_[marker].lines.view(); }

  // Mean displacement, rounded down, of the `known` markers around `marker`. Returns false if there are none.
  bool mean_around(std::span<const Marker> markers, std::span<const uint8_t> known, size_t marker,
                   ImagePoint& mean) const;
  // Mean displacement, rounded down, extrapolated from lines of two known markers. Returns false if there are none.
  bool mean_on_lines(std::span<const Marker> markers, std::span<const uint8_t> known, size_t marker,
                     ImagePoint& mean) const;
  // Ring by ring, unknown markers take the mean of the markers around them and count as known in the next round. At the
  // end `known` is 1 for all markers connected to a known one. `next`: work space of the same size.
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
