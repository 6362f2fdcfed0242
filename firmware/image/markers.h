// Identifies dots as markers of the board's lattice or of scattered places; displacement is always relative to rest.
//
// A marker is expected at rest + its last displacement; marker and dot must be each other's nearest within the gate.
// Markers without a dot are searched where their neighbours (image/marker_graph.h) went, ring by ring: on the line
// through two in a row, or at the mean of those around. If a marker is still lost, or clearly wrong
// (image/marker_quality.h), its displacement is the mean of the neighbours' (nearest ring first), and it is marked as
// lost.
//
// Frames may be far apart. If the assignment is ambiguous (a marker missing inside the view, unmatched dots, neighbours
// or frames more than about a third of a pitch apart), the lattice is matched again without memory: unmoved, and
// shifted as a whole so that a central marker meets each dot near it. Scattered markers grow from that one: a dot near
// another marker's place is no evidence unless two places look alike. The assignment with the lowest cost wins:
//
//   cost = 16 sum |d_i - d_j|^2 over neighbours + sum |d_i|^2
//          + 16 pitch^2 (markers missing inside the view) + 8 pitch^2 (unmatched dots)
//
// So torn neighbours or a missing row cost most, and of two equal assignments a whole pitch apart the one nearer to
// rest wins. Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "image/dots.h"
#include "image/marker_graph.h"

namespace ruffini {

struct Marker {
  ImagePx rest_x;
  ImagePx rest_y;
  ImagePx displacement_x;  // in the image, relative to rest
  ImagePx displacement_y;
  bool is_lost = true;    // the displacement is estimated from neighbours
  bool is_absent = true;  // not seen at rest either
  uint8_t quality = 0;    // 255 / (1 + (expected error / 0.1 px)^2), at least 1; 0: lost

  static constexpr uint8_t kMinConfident = 30;  // expected error of 0.27 px
  [[nodiscard]] bool is_confident() const { return !is_lost && quality >= kMinConfident; }
};

class MarkerTracker {
 public:
  explicit MarkerTracker(const BoardSettings& board);

  // Assigns the dots of the rest image to the board's lattice or listed places, outwards from the centre. The positions
  // may be off by 0.4 pitch along each axis at the centre, and their steps by 0.35 pitch locally (scale, rotation, lens
  // distortion). If scattered and not listed, each dot is a marker, in the order of the dots. Returns the number of
  // markers found.
  int learn(std::span<const Dot> dots);
  // Assigns the dots of one frame to markers. Markers that are not lost may then be refined.
  std::span<Marker> assign(std::span<const Dot> dots);
  // Rates and fills the markers, given the expected error of each, Q16 px squared. Returns the number of lost markers
  // that were there at rest.
  int finish(std::span<const int64_t> error2_q16);

  [[nodiscard]] std::span<const Marker> markers() const { return markers_; }
  [[nodiscard]] GridSize size() const { return size_; }

 private:
  using Point = ImagePoint;
  struct Nearest {
    int index = -1;
    int64_t distance2 = 0;
  };
  // Cost of an assignment; lengths in Q8 px, squared.
  struct AssignmentCost {
    int64_t cost = 0;
    int64_t widest2 = 0;  // largest difference between neighbours' displacements
    int n_missing = 0;    // inside the view
    int n_known = 0;
    int n_unmatched = 0;  // number of dots without a marker
  };

  void place_nominal(const BoardSettings& board);
  int take_all(std::span<const Dot> dots);
  [[nodiscard]] int nearest_free(std::span<const Dot> dots, const Point& place, int64_t limit2) const;
  int grow(std::span<const Dot> dots, int seed);
  void match(std::span<const Dot> dots, int64_t gate2);
  int accept(std::span<const Dot> dots);
  template <typename Start>
  void follow(std::span<const Dot> dots, Start start, int64_t gate2, int seed);
  [[nodiscard]] AssignmentCost assess(size_t n_dots) const;
  [[nodiscard]] bool is_ambiguous(const AssignmentCost& assignment) const;
  void search(std::span<const Dot> dots, int64_t cost_so_far);
  void expect_with_neighbours();

  GridSize size_;
  MarkerGraph graph_;
  bool is_scattered_;
  bool is_listed_;              // the rest positions are known in advance
  int64_t gate2_;               // squared, Q16 px: distance of a dot from the expected position
  int64_t tight_gate2_;         // the same without memory
  int64_t search2_;             // distance of a central marker's dot from its rest position
  int64_t pitch_q8_;            // px
  Point view_{};                // size of the picture, Q16 px
  int many_unmatched_;          // twice the number of unmatched dots that indicates a failure
  int64_t edge_;                // a marker this close to the picture's border may be cut off, Q16 px
  int middle_ = 0;              // the search starts from this marker
  int64_t seed_gate2_;          // distance of the first dot from its nominal position
  int64_t step_gate2_;          // distance of a dot from one nominal step beside its neighbour
  std::vector<Point> nominal_;  // the board's positions, if it lists them
  std::array<int, 4> seeds_{};  // central markers
  std::vector<Marker> markers_;
  std::vector<Point> expected_;
  std::vector<Nearest> dot_of_marker_;
  std::vector<Nearest> marker_of_dot_;
  std::vector<uint8_t> is_dot_taken_;
  std::vector<int> by_height_;    // indices of the frame's dots, sorted by y
  std::vector<int> queue_;        // markers found, in the order of growth
  std::vector<uint8_t> is_open_;  // still without a dot
  std::vector<uint8_t> is_led_;   // has a predicted position
  std::vector<uint8_t> known_;    // has a displacement, measured or filled
  std::vector<uint8_t> known_next_;
  std::vector<int> area_;  // of each known marker's dot, px
  std::vector<int> rest_area_;
  std::vector<int> best_area_;
  std::vector<Point> last_;  // displacement in the previous frame
  std::vector<Point> best_;  // of the cheapest assignment so far
  std::vector<uint8_t> best_known_;
};

// Detector settings derived from the board: a box of 0.6 pitch, and an area range around the nominal area.
[[nodiscard]] DotParameters dot_parameters(const BoardSettings& board);

}  // namespace ruffini
