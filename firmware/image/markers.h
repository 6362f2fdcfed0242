// Which dot is which marker: identity on the board's lattice or on scattered places, displacement always against rest.
//
// A marker is looked for at rest + its last displacement; marker and dot must be each other's nearest
// within the gate. What stays without a dot is looked for where its neighbours (image/marker_graph.h) went, ring by
// ring: on the line through two in a row, or where the mean of those around it is.
// Still lost, or surely wrong (image/marker_grade.h): the displacement is the mean of the neighbours' (nearest ring
// first), and marked.
//
// Frames may be far apart. Where the outcome is doubtful (a marker missing inside the view, dots left over, neighbours
// or frames more than about a third of a pitch apart), the lattice is laid on the dots anew, without memory: unmoved,
// and moved as a whole by what takes a middle marker to each dot near it. Scattered markers grow from that one: a dot
// near the place of another proves nothing where no two places look alike. The cheapest outcome counts,
//
//   cost = 16 sum |d_i - d_j|^2 over neighbours + sum |d_i|^2
//          + 16 pitch^2 (markers missing inside the view) + 8 pitch^2 (dots left over)
//
// so torn neighbours or a missing row costs most, and of two equal ones a whole pitch apart the nearer to rest wins.
// Frame thread; no allocation after the constructor.
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
  ImagePx displacement_x;  // image, against rest
  ImagePx displacement_y;
  bool is_lost = true;    // displacement estimated from neighbours
  bool is_absent = true;  // was not seen at rest either
  uint8_t quality = 0;    // 255 / (1 + (expected error / 0.1 px)^2), at least 1; 0: lost

  static constexpr uint8_t kSure = 30;  // it may be 0.27 px off
  [[nodiscard]] bool is_sure() const { return !is_lost && quality >= kSure; }
};

class MarkerTracker {
 public:
  explicit MarkerTracker(const BoardSettings& board);

  // Assign the dots of the rest image to the board's lattice or listed places, outwards from their middle. These may
  // be off by 0.4 pitch along each axis in the middle, their steps by 0.35 pitch, locally (scale, rotation, lens
  // distortion). Scattered and not listed: each dot is a marker, in the order of the dots. Number of markers found.
  int learn(std::span<const Dot> dots);
  // Give the dots of one frame to markers, which may then be refined where they are not lost.
  std::span<Marker> assign(std::span<const Dot> dots);
  // Grade and fill, with what each may be off, Q16 px squared. Number of markers lost that were there at rest.
  int finish(std::span<const int64_t> error2_q16);

  [[nodiscard]] std::span<const Marker> markers() const { return markers_; }
  [[nodiscard]] GridSize size() const { return size_; }

 private:
  using Point = ImagePoint;
  struct Nearest {
    int index = -1;
    int64_t distance2 = 0;
  };
  // How good an assignment is; lengths Q8 px, squared.
  struct Verdict {
    int64_t cost = 0;
    int64_t widest2 = 0;  // between neighbours' displacements
    int n_missing = 0;    // inside the view
    int n_known = 0;
    int n_left = 0;  // dots
  };

  void place_nominal(const BoardSettings& board);
  int take_all(std::span<const Dot> dots);
  [[nodiscard]] int nearest_free(std::span<const Dot> dots, const Point& place, int64_t limit2) const;
  int grow(std::span<const Dot> dots, int seed);
  void match(std::span<const Dot> dots, int64_t gate2);
  int accept(std::span<const Dot> dots);
  template <typename Start>
  void look(std::span<const Dot> dots, Start start, int64_t gate2, int seed);
  [[nodiscard]] Verdict judge(size_t n_dots) const;
  [[nodiscard]] bool is_doubtful(const Verdict& verdict) const;
  void search(std::span<const Dot> dots, int64_t cost_so_far);
  void expect_with_neighbours();

  GridSize size_;
  MarkerGraph graph_;
  bool is_scattered_;
  bool is_listed_;              // where the markers are is known before rest is
  int64_t gate2_;               // squared, Q16 px: dot from the place where it is expected
  int64_t tight_gate2_;         // the same where nothing is remembered
  int64_t search2_;             // a middle marker's dot from its rest place
  int64_t pitch_q8_;            // px
  Point view_{};                // size of the picture, Q16 px
  int many_left_;               // dots without a marker, twice as many: something is wrong
  int64_t edge_;                // a marker this near to the picture's border may be cut, Q16 px
  int middle_ = 0;              // marker that the search begins with
  int64_t seed_gate2_;          // the first dot from its nominal place
  int64_t step_gate2_;          // a dot from one nominal step beside its neighbour
  std::vector<Point> nominal_;  // the board's own places, where it lists them
  std::array<int, 4> seeds_{};  // markers in the middle of them
  std::vector<Marker> markers_;
  std::vector<Point> expected_;
  std::vector<Nearest> dot_of_marker_;
  std::vector<Nearest> marker_of_dot_;
  std::vector<uint8_t> is_dot_taken_;
  std::vector<int> by_height_;    // the frame's dots, upper ones first
  std::vector<int> queue_;        // markers found, in order of growth
  std::vector<uint8_t> is_open_;  // still looking for its dot
  std::vector<uint8_t> is_led_;   // knows where to look
  std::vector<uint8_t> known_;    // has a displacement of its own, or a filled one
  std::vector<uint8_t> known_next_;
  std::vector<int> area_;  // of each known marker's dot, px
  std::vector<int> rest_area_;
  std::vector<int> best_area_;
  std::vector<Point> last_;  // displacement in the frame before
  std::vector<Point> best_;  // of the cheapest assignment so far
  std::vector<uint8_t> best_known_;
};

// Detector settings that follow from the board: box of 0.6 pitch, area around the nominal one.
[[nodiscard]] DotParameters dot_parameters(const BoardSettings& board);

}  // namespace ruffini
