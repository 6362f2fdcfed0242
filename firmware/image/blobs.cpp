#include "image/blobs.h"

#include <algorithm>
#include <cstring>
#include <utility>

namespace ruffini {

static_assert(Blobs::kZeroRun * sizeof(int16_t) == 2 * sizeof(uint64_t));

Blobs::Blobs(int width_px, int height_px)
    : width_px_(width_px),
      height_px_(height_px),
      label_((static_cast<size_t>(width_px) + kZeroRun - 1) / kZeroRun * kZeroRun),
      blobs_(std::make_unique_for_overwrite<Blob[]>(static_cast<size_t>(width_px) * static_cast<size_t>(height_px) / 2 +
                                                    1)) {}

void Blobs::start() {
  n_ = 0;
  is_labelled_ = false;
  std::fill(label_.begin(), label_.end(), -1);
}

int Blobs::find(int blob) {
  while (blobs_[static_cast<size_t>(blob)].parent != blob) blob = blobs_[static_cast<size_t>(blob)].parent;
  return blob;
}

int Blobs::join(int a, int b) {
  a = find(a);
  b = find(b);
  if (a == b) return a;
  if (b < a) std::swap(a, b);
  Blob& kept = blobs_[static_cast<size_t>(a)];
  Blob& merged = blobs_[static_cast<size_t>(b)];
  merged.parent = a;
  kept.area += merged.area;
  kept.touches_border = kept.touches_border || merged.touches_border;
  kept.x += merged.x;
  kept.y += merged.y;
  kept.weight += merged.weight;
  kept.weight_x += merged.weight_x;
  kept.weight_y += merged.weight_y;
  return a;
}

// Adds the pixels [from, to) of row y, none of them zero, to the components above them, which it joins, or to a new
// one.
void Blobs::add_run(const int16_t* weight, int y, int from, int to) {
  int label = -1;
  int last_above = -1;
  int64_t sum = 0;
  int64_t sum_x = 0;
  for (int x = from; x < to; ++x) {
    const int above = label_[static_cast<size_t>(x)];
    if (above >= 0 && above != last_above) {
      label = label < 0 ? find(above) : join(label, above);
      last_above = above;
    }
    sum += weight[x];
    sum_x += int64_t{weight[x]} * x;
  }
  if (label < 0) {
    label = n_++;
    Blob& fresh = blobs_[static_cast<size_t>(label)];
    fresh = {};
    fresh.parent = label;
  }
  std::fill(label_.begin() + from, label_.begin() + to, label);
  Blob& blob = blobs_[static_cast<size_t>(label)];
  const int n = to - from;
  blob.area += n;
  blob.touches_border = blob.touches_border || from == 0 || y == 0 || to == width_px_ || y == height_px_ - 1;
  blob.x += int64_t{n} * (from + to - 1) / 2;
  blob.y += int64_t{n} * y;
  blob.weight += sum;
  blob.weight_x += sum_x;
  blob.weight_y += sum * y;
}

void Blobs::pass_over() {
  if (is_labelled_) std::fill(label_.begin(), label_.end(), -1);
  is_labelled_ = false;
}

void Blobs::add(std::span<const int16_t> weight, int y) {
  const auto are_zero = [&](size_t at) {
    uint64_t several[2];
    std::memcpy(several, &weight[at], sizeof several);
    return (several[0] | several[1]) == 0;
  };
  bool is_zero = true;
  for (size_t at = 0; at < label_.size() && is_zero; at += kZeroRun) is_zero = are_zero(at);
  if (is_zero) {  // most rows are, and follow another one
    pass_over();
    return;
  }
  is_labelled_ = true;
  for (int x = 0; x < width_px_;) {
    const auto at = static_cast<size_t>(x);
    if (x % kZeroRun == 0 && are_zero(at)) {
      std::fill_n(&label_[at], kZeroRun, -1);
      x += kZeroRun;
    } else if (weight[at] == 0) {
      label_[at] = -1;
      ++x;
    } else {
      int end = x + 1;
      while (end < width_px_ && weight[static_cast<size_t>(end)] != 0) ++end;
      add_run(weight.data(), y, x, end);
      x = end;
    }
  }
}

}  // namespace ruffini
