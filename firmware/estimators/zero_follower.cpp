#include "estimators/zero_follower.h"

#include <algorithm>
#include <cstdlib>

namespace ruffini {
namespace {

constexpr int64_t kStepNm = kDisplacementLsbNm;
constexpr int64_t kWindowUs = 1'000'000;
constexpr int64_t kHourUs = 3'600'000'000;
constexpr int64_t kMaxWindowUs = 2 * kWindowUs;  // a longer window had a gap, during which the pad's state is unknown
constexpr int32_t kLimit = static_cast<int32_t>((ZeroFollower::kLimitNm << 16) / kStepNm);
static_assert(int64_t{kLimit} * kStepNm >> 16 == ZeroFollower::kLimitNm, "the limit is whole steps");

DisplacementUm less(DisplacementUm u, int32_t zero_q16) {
  return DisplacementUm::from_raw(
      static_cast<int16_t>(std::clamp(u.raw() - ((zero_q16 + (1 << 15)) >> 16), -32'767, 32'767)));
}

}  // namespace

void ZeroFollower::run(std::span<NodeDisplacement> node, bool may_press, uint64_t capture_us) {
  const bool is_in_time = began_us_ != 0 && capture_us > began_us_ && capture_us - began_us_ <= kMaxWindowUs;
  if (may_press || capture_us == 0) {
    began_us_ = 0;
  } else {
    if (!is_in_time) {
      begin_window();
      began_us_ = capture_us;
    } else if (const auto elapsed_us = static_cast<int64_t>(capture_us - began_us_); elapsed_us >= kWindowUs) {
      follow(elapsed_us);
      begin_window();
      began_us_ = capture_us;
    }
    for (size_t i = 0; i < node.size(); ++i) {
      sum_[3 * i] += node[i].x.raw();
      sum_[3 * i + 1] += node[i].y.raw();
      sum_[3 * i + 2] += node[i].z.raw();
    }
    ++n_frames_;
  }
  if (moved_nm_ == 0) return;
  for (size_t i = 0; i < node.size(); ++i) {
    node[i] = {less(node[i].x, zero_[3 * i]), less(node[i].y, zero_[3 * i + 1]), less(node[i].z, zero_[3 * i + 2])};
  }
}

void ZeroFollower::follow(int64_t elapsed_us) {
  const auto most = static_cast<int32_t>((kNmPerHour << 16) * elapsed_us / (kStepNm * kHourUs));
  int32_t farthest = 0;
  for (size_t i = 0; i < zero_.size(); ++i) {
    const int64_t mean_q16 = (int64_t{sum_[i]} << 16) / n_frames_;
    zero_[i] += static_cast<int32_t>(std::clamp<int64_t>(mean_q16 - zero_[i], -most, most));
    zero_[i] = std::clamp(zero_[i], -kLimit, kLimit);
    farthest = std::max(farthest, std::abs(zero_[i]));
  }
  moved_nm_ = farthest * kStepNm >> 16;
}

void ZeroFollower::begin_window() {
  std::fill(sum_.begin(), sum_.end(), 0);
  n_frames_ = 0;
}

void ZeroFollower::forget() {
  std::fill(zero_.begin(), zero_.end(), 0);
  began_us_ = 0;
  moved_nm_ = 0;
}

}  // namespace ruffini
