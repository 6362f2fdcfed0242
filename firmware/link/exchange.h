// What the frame thread and the link thread share: atomics and one ring, no lock.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>

#include "base/spsc_ring.h"
#include "frame_path.h"
#include "infer/learned_result.h"

namespace ruffini {

inline constexpr size_t kMessageTypes = 17;
inline constexpr size_t kTelemetryRingBytes = size_t{4} << 20;
inline constexpr int32_t kNoTemperature = INT32_MIN;
inline constexpr int kNoZero = -1;
inline constexpr int kGiveUpZero = -2;
inline constexpr uint32_t kPowerShortNow = 0x1;  // bit of `throttled`
inline constexpr uint32_t kThrottledNow = 0xF;   // bits of `throttled` that are so now (hw/throttling.h)

// Numbers are those of ReflexState in ruffini.proto.
enum class ReflexState : uint8_t { kNotAsked = 0, kOff = 1, kOn = 2, kFailed = 3 };

// Of the path in use: its frames so far, and how many of them had no flag that makes forces invalid.
struct PathTally {
  uint32_t calibration_id = 0;
  uint16_t n_frames = 0;  // stays at its largest
  uint16_t n_good = 0;
};
// The last frame that was computed; the link thread reads it when none has come for a while.
struct LastFrame {
  std::atomic<uint64_t> capture_us{0};
  std::atomic<uint64_t> number{0};
  std::atomic<uint32_t> calibration_id{0};
  std::atomic<uint32_t> wrench_validity{0};  // 4 bits each, the first lowest
};
static_assert(std::atomic<PathTally>::is_always_lock_free);

struct Exchange {
  // Written by the link thread, read by the frame thread.
  std::array<std::atomic<uint32_t>, kMessageTypes> every{};  // send each n-th frame; 0 = never
  std::atomic<int> zero_frames{kNoZero};                     // request, or one of the two above
  std::atomic<bool> zero_even_if_touched{false};             // of that request
  std::atomic<FramePath*> next_path{nullptr};                // to swap in between frames; ownership passes
  std::atomic<int32_t> milli_celsius{kNoTemperature};        // of the board's thermometer
  // Of the link thread alone.
  std::atomic<uint32_t> throttled{0};        // hw/throttling.h
  std::atomic<bool> has_light_fault{false};  // the lamps are not as the board asks
  // Written by the frame thread, read by the link thread.
  std::atomic<FramePath*> retired_path{nullptr};  // to be deleted by the link thread
  SpscRing telemetry{kTelemetryRingBytes};        // u8 message type, then its frames
  std::atomic<uint64_t> frames_processed{0};
  std::atomic<uint64_t> saturations{0};
  std::atomic<uint64_t> telemetry_dropped{0};
  std::atomic<uint32_t> flags{0};
  std::atomic<PathTally> tally{};
  LastFrame last_frame;
  std::atomic<uint32_t> wrong_flags{0};  // all that the path in use has had of kWrongFlags
  std::atomic<bool> is_touched{false};   // something presses on the pad
  std::atomic<bool> is_zeroing{false};   // another rest is being learned
  std::atomic<uint32_t> refused_zeros{0};
  std::atomic<uint64_t> missed_deadlines{0};
  std::atomic<uint32_t> zero_moved_nm{0};  // by creep, since rest was learned
  std::atomic<bool> is_zero_at_limit{false};
  std::atomic<ReflexState> reflex{ReflexState::kNotAsked};
  std::atomic<uint64_t> reflex_trips{0};
  std::atomic<uint32_t> skin_light_1e3{0};                       // at rest, over the calibration's; 0: not known
  std::array<std::atomic<uint64_t>, kMaxStages> stage_sum_ns{};  // since the last status
  std::array<std::atomic<uint64_t>, kMaxStages> stage_max_ns{};
  // Written by the network's thread, where the board asks for one.
  NetworkHealth network;
  // Written by the capture thread.
  std::atomic<bool> is_camera_live{false};  // frames come by themselves, and are not over
  std::atomic<uint64_t> frames_captured{0};
  std::atomic<uint64_t> frames_overrun{0};
  std::atomic<uint64_t> frames_invalid{0};
  std::atomic<uint64_t> frames_missed{0};    // numbered by the camera, never given
  std::atomic<uint64_t> frames_repeated{0};  // not used (capture/frame_order.h)
  std::atomic<uint64_t> time_faults{0};
  std::atomic<uint64_t> capture_turns{0};  // of its loop, for the watchdog
};

}  // namespace ruffini
