// Result of a learned network for one frame, and the health of the network: passed from its thread to the frame and
// link threads.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>

namespace ruffini {

inline constexpr size_t kMaxLearned = 16;  // outputs of a network: Learned.quantities in ruffini.options

// Identifies the processed frame.
struct LearnedStamp {
  uint64_t capture_us = 0;
  uint64_t frame = 0;
  uint32_t flags = 0;  // of the frame path
  uint32_t calibration_id = 0;
};

struct LearnedResult {
  LearnedStamp stamp;
  bool is_valid = false;  // finite, and within the range of the training data
  size_t n_values = 0;    // 0: the network gave no number
  std::array<int64_t, kMaxLearned> value{};
  uint32_t took_us = 0;     // time of the network alone
  uint32_t latency_us = 0;  // from mid-exposure to the result
  uint32_t period_us = 0;   // since the previous result; 0: first result
};

// Numbers are those of NetworkState in ruffini.proto.
enum class NetworkState : uint8_t { kLoading = 0, kRuns = 1, kFailed = 2 };

// Written by the network's thread, read by any. The texts are written once, before `state` leaves kLoading.
struct NetworkHealth {
  std::atomic<bool> is_asked{false};  // the board asks for a network
  std::atomic<NetworkState> state{NetworkState::kLoading};
  std::array<char, 256> problem{};
  std::array<uint8_t, 32> sha256{};
  std::atomic<uint64_t> results{0};
  std::atomic<uint64_t> invalid{0};
  std::atomic<uint64_t> skipped{0};
  std::atomic<uint32_t> took_us{0};  // these three of the last result
  std::atomic<uint32_t> latency_us{0};
  std::atomic<uint32_t> period_us{0};
};

}  // namespace ruffini
