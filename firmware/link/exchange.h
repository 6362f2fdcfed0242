// Data shared by the frame thread and the link thread: atomics and one ring, no lock.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cstdint>
#include <memory>
#include <span>

#include "base/spsc_ring.h"
#include "frame_path.h"
#include "infer/learned_result.h"
#include "link/frame_codec.h"

namespace ruffini {

inline constexpr size_t kMessageTypes = 18;
inline constexpr size_t kTelemetryRingBytes = size_t{4} << 20;
inline constexpr int32_t kNoTemperature = INT32_MIN;
inline constexpr int kNoZeroRequest = -1;
inline constexpr int kCancelZero = -2;
inline constexpr uint32_t kUndervoltageNow = 0x1;  // bit of `throttled`
inline constexpr uint32_t kClockLowered = 0x6;     // bits of `throttled`: clock capped or throttled at present
inline constexpr uint32_t kThrottledNow = 0xF;     // bits of `throttled` that hold at present (hw/throttling.h)

// Numbers are those of ReflexState in ruffini.proto.
enum class ReflexState : uint8_t { kNotConfigured = 0, kOff = 1, kOn = 2, kFailed = 3 };

// Counts for the path in use: frames so far, and those without a flag that invalidates forces.
struct PathTally {
  uint32_t calibration_id = 0;
  uint16_t n_frames = 0;  // saturates
  uint16_t n_good = 0;
};
// Precedes the frames of a message in Exchange::telemetry.
struct TelemetryHead {
  uint64_t exposed_us = 0;  // end of the exposure that the message results from; 0: not known, latency is not measured
  uint64_t type = 0;        // MessageType

  using Bytes = std::array<uint8_t, 2 * sizeof(uint64_t)>;
};
// The last computed frame. The link thread reads it if no further frame has come for a while.
struct LastFrame {
  std::atomic<uint64_t> capture_us{0};
  std::atomic<uint64_t> number{0};
  std::atomic<uint32_t> calibration_id{0};
  std::atomic<uint32_t> wrench_validity{0};  // 4 bits each, the first lowest
};
static_assert(std::atomic<PathTally>::is_always_lock_free);

// Room for the largest message and for about two pictures: what the link thread does not take within a frame's time is
// dropped and counted, beside pictures sooner than without them.
inline size_t telemetry_ring_bytes(const BoardSettings& board) {
  constexpr size_t kLeast = size_t{1} << 20;
  static_assert(sizeof(uint32_t) + sizeof(TelemetryHead::Bytes) + kMaxFragments * kMaxFrameBytes <= kLeast);
  const auto n_pixels = static_cast<size_t>(board.camera.width_px) * static_cast<size_t>(board.camera.height_px);
  return std::clamp(std::bit_ceil(2 * 3 * n_pixels), kLeast, kTelemetryRingBytes);
}

struct Exchange {
  explicit Exchange(size_t telemetry_bytes = kTelemetryRingBytes) : telemetry(telemetry_bytes) {}

  // Frame thread. Returns false if the ring has no room.
  [[nodiscard]] bool push_telemetry(const TelemetryHead& head, std::span<const uint8_t> frames) {
    return telemetry.push(std::bit_cast<TelemetryHead::Bytes>(head), frames);
  }

  // Written by the link thread, read by the frame thread.
  std::array<std::atomic<uint32_t>, kMessageTypes> every{};  // send every n-th frame; 0: none
  std::atomic<int> zero_frames{kNoZeroRequest};              // request, or one of the two constants above
  std::atomic<bool> zero_even_if_touched{false};             // of that request
  std::atomic<FramePath*> next_path{nullptr};                // to swap in between frames; ownership passes
  std::atomic<int32_t> milli_celsius{kNoTemperature};        // of the board's thermometer
  std::atomic<uint32_t> throttled{0};                        // hw/throttling.h
  // Used by the link thread only.
  std::atomic<bool> has_light_fault{false};  // the lamps are not in the state that the board demands
  // Written by the frame thread, read by the link thread.
  std::atomic<FramePath*> retired_path{nullptr};  // to be deleted by the link thread
  SpscRing telemetry;                             // TelemetryHead, then the frames of one message
  std::atomic<uint64_t> frames_processed{0};
  std::atomic<uint64_t> saturations{0};
  std::atomic<uint64_t> telemetry_dropped{0};
  std::atomic<uint32_t> flags{0};
  std::atomic<PathTally> tally{};
  LastFrame last_frame;
  std::atomic<uint32_t> wrong_flags{0};  // union of the kWrongFlags of all frames of the path in use
  std::atomic<bool> is_touched{false};   // the pad is in contact
  std::atomic<bool> is_zeroing{false};   // a new rest image is being learned
  std::atomic<uint32_t> refused_zeros{0};
  std::atomic<uint64_t> missed_deadlines{0};
  std::atomic<uint32_t> rate_divisor{1};   // capture/rate_governor.h; the capture thread uses one frame of so many
  std::atomic<uint32_t> zero_moved_nm{0};  // due to creep, since rest was learned
  std::atomic<bool> is_zero_at_limit{false};
  std::atomic<ReflexState> reflex{ReflexState::kNotConfigured};
  std::atomic<uint64_t> reflex_trips{0};
  std::atomic<uint32_t> frame_priority{0};  // hw/thread_place.h, of the frame thread
  std::atomic<uint64_t> frame_cpus{0};
  std::atomic<uint32_t> skin_light_1e3{0};                     // at rest, relative to the calibration; 0: unknown
  std::array<std::atomic<uint64_t>, kMaxRows> stage_sum_ns{};  // since the last status
  std::array<std::atomic<uint64_t>, kMaxRows> stage_max_ns{};
  // Written by the thread of the learned network, if the board has one.
  NetworkHealth network;
  // Written by the capture thread.
  std::atomic<bool> is_camera_live{false};  // frames arrive on their own, and the stream has not ended
  std::atomic<uint64_t> frames_captured{0};
  std::atomic<uint64_t> frames_overrun{0};
  std::atomic<uint64_t> frames_invalid{0};
  std::atomic<uint64_t> frames_left_out{0};  // because of rate_divisor
  std::atomic<uint64_t> frames_missed{0};    // numbers that the camera skipped
  std::atomic<uint64_t> frames_repeated{0};  // discarded (capture/frame_order.h)
  std::atomic<uint64_t> time_faults{0};
  std::atomic<uint64_t> capture_iterations{0};  // returns of its wait for a frame, for the watchdog
};

}  // namespace ruffini
