// What may go wrong. Each seed switches on some of it (swarm testing, Groce et al. 2012): faults hide one another.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "dice.h"

namespace ruffini::sim {

enum class Fault : uint8_t {
  // The line, by pieces of at most 512 bytes.
  kPieceLost,
  kPieceFlipped,
  kPieceTwice,
  kPiecesSwapped,
  kPieceLate,
  kShortWrite,
  kHangUp,
  kEcho,
  kGarbage,
  kHostReadsSlowly,
  kHostFloods,
  kHostRestarts,
  // The camera.
  kCameraStalls,
  kFrameLost,
  kFrameTwice,
  kFrameOfAnotherSize,
  kTimeJumps,
  kDark,
  kGlare,
  kNoise,
  // The device's own pace.
  kSlowFrames,
  kSlowLink,
  // Medium and power.
  kDiskError,
  kPowerCut,
  kCutInStore,
  kCrash,
  // What people do.
  kBadTable,
  kCount
};
inline constexpr size_t kFaults = static_cast<size_t>(Fault::kCount);
inline constexpr std::array<const char*, kFaults> kFaultNames = {"piece lost",
                                                                 "piece flipped",
                                                                 "piece twice",
                                                                 "pieces swapped",
                                                                 "piece late",
                                                                 "short write",
                                                                 "hang-up",
                                                                 "echo",
                                                                 "garbage",
                                                                 "host reads slowly",
                                                                 "host floods",
                                                                 "host restarts",
                                                                 "camera stalls",
                                                                 "frame lost",
                                                                 "frame twice",
                                                                 "another size",
                                                                 "time jumps",
                                                                 "dark",
                                                                 "glare",
                                                                 "noise",
                                                                 "slow frame thread",
                                                                 "slow link thread",
                                                                 "disk error",
                                                                 "power cut",
                                                                 "cut in the store",
                                                                 "crash",
                                                                 "bad table"};

// Which faults a seed has, and how often each came.
class Swarm {
 public:
  explicit Swarm(Dice dice) : dice_(dice) {
    for (size_t i = 0; i < kFaults; ++i) is_on_[i] = dice_.chance(400'000);
  }
  // Where the fault is on: so often.
  bool strikes(Fault fault, uint64_t per_million) {
    if (!has(fault) || !dice_.chance(per_million)) return false;
    count(fault);
    return true;
  }
  [[nodiscard]] bool has(Fault fault) const { return !is_calm_ && is_on_[static_cast<size_t>(fault)]; }
  void count(Fault fault) { ++counts_[static_cast<size_t>(fault)]; }
  // From now on nothing goes wrong any more.
  void calm() { is_calm_ = true; }
  [[nodiscard]] bool is_calm() const { return is_calm_; }
  [[nodiscard]] const std::array<uint64_t, kFaults>& counts() const { return counts_; }

 private:
  Dice dice_;
  std::array<bool, kFaults> is_on_{};
  std::array<uint64_t, kFaults> counts_{};
  bool is_calm_ = false;
};

}  // namespace ruffini::sim
