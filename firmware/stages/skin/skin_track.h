// Identifies touches of a skin from frame to frame, and averages each over the last frames.
//
// Each touch takes the identity of the nearest previous one within kReachUm, nearest pairs first; the remaining touches
// get new identities. A touch that disappears keeps its identity for kMaxUnseenFrames. Force is the mean over at most
// [skin] averaged_frames frames of the same identity, position is that of the current frame. Frame thread; no
// allocation.
#pragma once

#include <array>
#include <cstdint>

#include "board/settings.h"
#include "core/results.h"

namespace ruffini {

class SkinTrack {
 public:
  static constexpr int64_t kReachUm = 12'000;
  static constexpr int kMaxUnseenFrames = 5;

  explicit SkinTrack(const BoardSettings& board);

  void run(SkinTouchList& list);
  // Resets the history: the next touches are new ones.
  void forget();

 private:
  static constexpr size_t kSlots = size_t{2} * SkinTouchList::kMax;

  struct Slot {
    uint32_t id = 0;  // 0: free
    int64_t x_um = 0;
    int64_t y_um = 0;
    int n_unseen = 0;
    bool is_taken = false;  // matched in this frame
    std::array<int64_t, kMaxAveragedFrames> press_un{};
    int n_frames = 0;
  };

  [[nodiscard]] int64_t distance2(const SkinTouch& touch, const Slot& slot) const;
  [[nodiscard]] Slot& begin();
  void follow(SkinTouch& touch, Slot& slot) const;

  int64_t round_um_;  // circumference of a tube, else 0
  int averaged_frames_;
  uint32_t last_id_ = 0;
  std::array<Slot, kSlots> slots_{};
};

}  // namespace ruffini
