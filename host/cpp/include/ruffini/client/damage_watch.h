// Reports a line that is unfit for control: two damaged frames within six minutes (proto/README.md).
#pragma once

#include <array>
#include <cstdint>

namespace ruffini::client {

// Keep one for each line, over all Decoders; each reconnection needs a new Decoder.
class DamageWatch {
 public:
  // `n_damaged`: Counters::damaged() of the current Decoder. `now_s`: a monotonic clock. True when the line becomes unfit.
  bool update(uint64_t n_damaged, double now_s) {
    const bool was_unfit = is_unfit(now_s);
    const uint64_t n_new = n_damaged > n_damaged_ ? n_damaged - n_damaged_ : 0;
    n_damaged_ = n_damaged;
    if (n_new > 0) last_s_ = {n_new > 1 ? now_s : last_s_[1], now_s};
    return !was_unfit && is_unfit(now_s);
  }

  // Call when a Decoder replaces the last one, since it counts from 0.
  void begin_decoder() { n_damaged_ = 0; }

  [[nodiscard]] bool is_unfit(double now_s) const { return now_s - last_s_[0] < kIntervalS; }

 private:
  // One damaged frame in six minutes is ten an hour. The CRC passes one in 2^32 of these: 2.3e-9 wrong frames an hour.
  static constexpr double kIntervalS = 360.0, kLongAgoS = -1e12;

  std::array<double, 2> last_s_{kLongAgoS, kLongAgoS};  // times of the last two damaged frames
  uint64_t n_damaged_ = 0;
};

}  // namespace ruffini::client
