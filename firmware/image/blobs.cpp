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

void Blobs::count(Blob& blob, int x, int y, int32_t weight) const {
  ++blob.area;
  blob.touches_border = blob.touches_border || x == 0 || y == 0 || x == width_px_ - 1 || y == height_px_ - 1;
  blob.x += x;
  blob.y += y;
  blob.weight += weight;
  blob.weight_x += int64_t{weight} * x;
  blob.weight_y += int64_t{weight} * y;
}

void Blobs::add(std::span<const int16_t> weight, int y) {
  int left = -1;
  for (int x = 0; x < width_px_; ++x) {
    const auto at = static_cast<size_t>(x);
    if (x % kZeroRun == 0) {  // most weights are zero
      uint64_t several[2];
      std::memcpy(several, &weight[at], sizeof several);
      if ((several[0] | several[1]) == 0) {
        std::fill_n(&label_[at], kZeroRun, -1);
        left = -1;
        x += kZeroRun - 1;
        continue;
      }
    }
    int& label = label_[at];
    const int above = label;
    if (weight[at] == 0) {
      label = left = -1;
      continue;
    }
    if (left >= 0 && above >= 0) {
      label = join(left, above);
    } else if (left >= 0 || above >= 0) {
      label = find(std::max(left, above));
    } else {
      label = n_++;
      Blob& fresh = blobs_[static_cast<size_t>(label)];
      fresh = {};
      fresh.parent = label;
    }
    left = label;
    count(blobs_[static_cast<size_t>(label)], x, y, weight[at]);
  }
}

}  // namespace ruffini
