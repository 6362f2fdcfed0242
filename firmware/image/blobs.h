// Connected spots of a picture that comes row by row as weights, zero outside: sums of each in a single pass.
//
// Components are 4-connected. A label is a place in the list of components; a child points to its parent after a union,
// and the smaller index stays, so that a component keeps the place of its first pixel. Frame thread; no allocation
// after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace ruffini {

struct Blob {
  int parent = 0;
  int area = 0;
  bool touches_border = false;
  int64_t x = 0;  // sums over its pixels
  int64_t y = 0;
  int64_t weight = 0;
  int64_t weight_x = 0;
  int64_t weight_y = 0;
};

class Blobs {
 public:
  static constexpr int kZeroRun = 4;  // weights that are looked at together

  Blobs(int width_px, int height_px);

  void start();
  // Of rows of `row()`'s length, top to bottom; what lies beyond the width must be zero.
  void add(std::span<const int16_t> weight, int y);
  // Length of a row that add() takes: the width, rounded up.
  [[nodiscard]] size_t row() const { return label_.size(); }
  // All components that were ever begun; those whose parent is another were joined to it.
  [[nodiscard]] std::span<const Blob> all() const { return {blobs_.data(), static_cast<size_t>(n_)}; }

 private:
  int find(int blob);
  int join(int a, int b);
  void count(Blob& blob, int x, int y, int32_t weight) const;

  int width_px_;
  int height_px_;
  std::vector<int32_t> label_;  // of the row above, overwritten by the current one; -1 = none
  std::vector<Blob> blobs_;
  int n_ = 0;
};

}  // namespace ruffini
