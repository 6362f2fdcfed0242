// Latency of frames on the line: from the end of a frame's exposure to the last byte of its results that the line
// accepted. A histogram of fixed size; its bins are 1/32 of the latency wide, so a percentile is at most 3.2 % too
// high. Link thread only.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

namespace ruffini {

class LineLatency {
 public:
  static constexpr uint64_t kMaxUs = (uint64_t{1} << 24) - 1;  // longer ones count as this: 16.8 s

  // The line accepted the last byte of a message. Of a frame's messages the last one counts; `exposed_us` identifies
  // the frame. Messages of a frame older than the last are ignored.
  void add(uint64_t exposed_us, uint64_t now_us) {
    if (exposed_us < exposed_us_) return;
    if (exposed_us == exposed_us_) {
      --n_[bin_];
    } else {
      ++n_frames_;
    }
    exposed_us_ = exposed_us;
    const uint64_t latency_us = now_us < exposed_us ? 0 : std::min(now_us - exposed_us, kMaxUs);
    bin_ = bin_of(latency_us);
    ++n_[bin_];
    max_us_ = std::max(max_us_, static_cast<uint32_t>(latency_us));
  }
  void reset() { *this = {}; }

  [[nodiscard]] uint64_t n_frames() const { return n_frames_; }
  [[nodiscard]] uint32_t max_us() const { return max_us_; }
  // The smallest limit of a bin, at most max_us(), that `per_mille` of the frames did not exceed; 0: there is no frame.
  [[nodiscard]] uint32_t percentile_us(uint32_t per_mille) const {
    const uint64_t wanted = (n_frames_ * per_mille + 999) / 1'000;
    uint64_t n = 0;
    for (size_t bin = 0; bin < kBins; ++bin) {
      n += n_[bin];
      if (n >= wanted && n > 0) return std::min(limit_of(bin), max_us_);
    }
    return 0;
  }

 private:
  static constexpr size_t kBinsPerOctave = 32;
  static constexpr size_t kOctaveBits = 5;
  static constexpr size_t kBins = 2 * kBinsPerOctave + (24 - kOctaveBits - 1) * kBinsPerOctave;

  // Up to 63 us one bin per microsecond, then 32 per octave: mantissa of six bits, the first of them 1.
  static size_t bin_of(uint64_t us) {
    if (us < 2 * kBinsPerOctave) return static_cast<size_t>(us);
    const size_t shift = static_cast<size_t>(std::bit_width(us)) - kOctaveBits - 1;
    return shift * kBinsPerOctave + static_cast<size_t>(us >> shift);
  }
  static uint32_t limit_of(size_t bin) {
    if (bin < 2 * kBinsPerOctave) return static_cast<uint32_t>(bin);
    const size_t shift = bin / kBinsPerOctave - 1;
    return static_cast<uint32_t>(((bin - shift * kBinsPerOctave + 1) << shift) - 1);
  }

  std::array<uint32_t, kBins> n_{};
  uint64_t exposed_us_ = 0;  // of the last frame
  size_t bin_ = 0;           // where it is counted
  uint64_t n_frames_ = 0;
  uint32_t max_us_ = 0;
};

}  // namespace ruffini
