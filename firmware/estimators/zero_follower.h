// Follows the slow creep of an untouched pad and subtracts it from the displacement. For live cameras.
//
//   out = u - round(zero)                          each component of each node
//   for each second without contact and without an invalid frame, m = mean of u over its frames:
//   zero += clamp(m - zero, +-kNmPerHour / 3600)   within kLimitNm of the rest image
//
// A load above the contact threshold is never learned. A load below it is, at kNmPerHour and at most kLimitNm in total:
// that is the largest error this class can cause. Zeroing restarts it. Frame thread; no allocation after the
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

  // `may_press`: there may be contact, or the frame is invalid. Without a capture time (0) nothing is learned.
  void run(std::span<NodeDisplacement> node, bool may_press, uint64_t capture_us);
  // Restarts from a new rest image.
  void forget();

  // Largest change of any component since the rest image.
  [[nodiscard]] int64_t moved_nm() const { return moved_nm_; }
  [[nodiscard]] bool is_at_limit() const { return moved_nm_ >= kLimitNm; }

 private:
  void begin_window();
  void follow(int64_t elapsed_us);

  std::vector<int32_t> zero_;  // Q16 of a step of DisplacementUm
  std::vector<int32_t> sum_;   // sums over the frames of the current second, in steps
  int64_t n_frames_ = 0;
  uint64_t began_us_ = 0;  // 0: no second has begun
  int64_t moved_nm_ = 0;
};

}  // namespace ruffini
