// Creep of a pad that nothing touches: its displacement at rest, followed slowly. For live cameras.
//
//   out = u - round(zero)                          each component of each node
//   each second in which nothing pressed and no frame was wrong, m = mean of u over its frames:
//   zero += clamp(m - zero, +-kNmPerHour / 3600)   at most kLimitNm from the rest image
//
// A load that counts as a touch is never learned; one that stays below what counts as a touch is, at kNmPerHour, and in all
// no more than kLimitNm: that is what this can hide. A zero begins anew. Frame thread; no allocation after the
// constructor. Not in the papers.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "image/displacement.h"

namespace ruffini {

class ZeroFollower {
 public:
  static constexpr int64_t kNmPerHour = 2'000;
  static constexpr int64_t kLimitNm = 10'000;

  explicit ZeroFollower(size_t n_nodes) : zero_(3 * n_nodes), sum_(3 * n_nodes) {}

  // `may_press`: something may press on the pad, or the frame is wrong. Without a capture time (0) nothing is learned.
  void run(std::span<NodeDisplacement> node, bool may_press, uint64_t capture_us);
  // Rest is new.
  void forget();

  // How far the farthest component has moved since.
  [[nodiscard]] int64_t moved_nm() const { return moved_nm_; }
  [[nodiscard]] bool is_at_limit() const { return moved_nm_ >= kLimitNm; }

 private:
  void begin_window();
  void follow(int64_t elapsed_us);

  std::vector<int32_t> zero_;  // Q16 of a step of DisplacementUm
  std::vector<int32_t> sum_;   // of the frames of this second, steps
  int64_t n_frames_ = 0;
  uint64_t began_us_ = 0;  // 0: no second runs
  int64_t moved_nm_ = 0;
};

}  // namespace ruffini
