// Finds connected components in an image of weights that arrives row by row, and accumulates sums of each in a single
// pass.
//
// Components are 4-connected; a run of pixels side by side gets one label. A label is an index into the list of
// components. After a union the child points to its parent, and the smaller index survives, so a component keeps the
// position of its first pixel. Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

namespace ruffini {

struct Blob {  // without initializers, so that the room for the worst picture takes no memory until it is needed
  int parent;
  int area;
  bool touches_border;
  int64_t x;  // sums over its pixels
  int64_t y;
  int64_t weight;
  int64_t weight_x;
  int64_t weight_y;
};

class Blobs {
 public:
  static constexpr int kZeroRun = 8;  // weights tested together for zero

  Blobs(int width_px, int height_px);

  void start();
  // Adds one row of row() weights; rows come from top to bottom, and values beyond the width must be zero.
  void add(std::span<const int16_t> weight, int y);
  // Adds rows in which every weight is zero.
  void pass_over();
  // Length of a row passed to add(): the width, rounded up.
  [[nodiscard]] size_t row() const { return label_.size(); }
  // All components created so far. Those whose parent is another component were merged into it.
  [[nodiscard]] std::span<const Blob> all() const { return {blobs_.get(), static_cast<size_t>(n_)}; }

 private:
  int find(int blob);
  int join(int a, int b);
  void add_run(const int16_t* weight, int y, int from, int to);

  int width_px_;
  int height_px_;
  bool is_labelled_ = false;    // not all of label_ are -1
  std::vector<int32_t> label_;  // labels of the row above, overwritten by those of the current row; -1: none
  std::unique_ptr<Blob[]> blobs_;
  int n_ = 0;
};

}  // namespace ruffini
