// Who is who among the touches of a skin from frame to frame, and the mean of the last frames of each.
//
// Each touch takes the identity of the nearest one before, nearest pairs first, within kReachUm; what is left begins a
// new one. A touch that is not seen keeps its identity for kKeptFrames. Force is the mean over at most [skin]
// averaged_frames frames of the same identity, place is of this frame. Frame thread; no allocation.
#pragma once

#include <array>
#include <cstdint>

#include "board/settings.h"
#include "core/results.h"

namespace ruffini {

class SkinTrack {
 public:
  static constexpr int64_t kReachUm = 12'000;
  static constexpr int kKeptFrames = 5;

  explicit SkinTrack(const BoardSettings& board);

  void run(SkinTouchList& list);
  // The next touches are new ones.
  void forget();

 private:
  static constexpr size_t kSlots = size_t{2} * SkinTouchList::kMax;

  struct Slot {
    uint32_t id = 0;  // 0: free
    int64_t x_um = 0;
    int64_t y_um = 0;
    int n_unseen = 0;
    bool is_taken = false;  // in this frame
    std::array<int64_t, kMaxAveragedFrames> press_un{};
    int n_frames = 0;
  };

  [[nodiscard]] int64_t distance2(const SkinTouch& touch, const Slot& slot) const;
  [[nodiscard]] Slot& begin();
  void follow(SkinTouch& touch, Slot& slot) const;

  int64_t round_um_;  // way once round a tube, else 0
  int averaged_frames_;
  uint32_t last_id_ = 0;
  std::array<Slot, kSlots> slots_{};
};

}  // namespace ruffini
