// The segment with which a frame changes from the first frame thread to the second, so that both take the same time.
//
// Each thread keeps its segments, because their buffers are then in its core's cache. Results do not depend on the cut.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>

#include "core/slots.h"

namespace ruffini {

class SegmentCut {
 public:
  // Any thread. In 1 to n - 1.
  [[nodiscard]] size_t get() const { return cut_.load(std::memory_order_relaxed); }

  // Second thread: the times of one frame in n >= 2 segments.
  void record(const std::array<uint64_t, kMaxSegments>& segment_ns, size_t n) {
    for (size_t i = 0; i < n; ++i) {
      const auto now = static_cast<int64_t>(segment_ns[i]);
      mean_ns_[i] = has_mean_ ? mean_ns_[i] + (now - mean_ns_[i]) / kFrames : now;
    }
    has_mean_ = true;
    size_t best = get();
    const int64_t current = longer_side(best, n);
    for (size_t cut = 1; cut < n; ++cut) {
      if (longer_side(cut, n) < longer_side(best, n)) best = cut;
    }
    if (longer_side(best, n) < current - current / kLeastGain) cut_.store(best, std::memory_order_relaxed);
  }

 private:
  static constexpr int64_t kFrames = 16;     // about so many are averaged
  static constexpr int64_t kLeastGain = 16;  // a change of cut costs cache misses: it must gain such a part

  [[nodiscard]] int64_t longer_side(size_t cut, size_t n) const {
    int64_t before = 0, after = 0;
    for (size_t i = 0; i < n; ++i) (i < cut ? before : after) += mean_ns_[i];
    return std::max(before, after);
  }

  std::atomic<size_t> cut_{1};
  std::array<int64_t, kMaxSegments> mean_ns_{};
  bool has_mean_ = false;
};

}  // namespace ruffini
