#include "stages/skin/skin_track.h"

#include <algorithm>
#include <cstdlib>

#include "base/fixed.h"

namespace ruffini {

SkinTrack::SkinTrack(const BoardSettings& board)
    : round_um_(board.skin.shape == SkinShape::kTube ? board.pad.size_x_um : 0),
      averaged_frames_(std::clamp(board.skin.averaged_frames, 1, kMaxAveragedFrames)) {}

void SkinTrack::forget() { slots_ = {}; }

int64_t SkinTrack::distance2(const SkinTouch& touch, const Slot& slot) const {
  int64_t dx = std::abs(touch.x_um - slot.x_um);
  if (round_um_ > 0) dx = std::min(dx, round_um_ - dx);
  const int64_t dy = touch.y_um - slot.y_um;
  return dx * dx + dy * dy;
}

// Returns a free slot, or the one unseen for longest; there are twice as many slots as touches.
SkinTrack::Slot& SkinTrack::begin() {
  Slot* best = &slots_.front();
  for (Slot& slot : slots_) {
    if (slot.is_taken) continue;
    if (best->is_taken || slot.id == 0 || (best->id != 0 && slot.n_unseen > best->n_unseen)) best = &slot;
    if (slot.id == 0) break;
  }
  *best = Slot{.id = ++last_id_};
  return *best;
}

void SkinTrack::follow(SkinTouch& touch, Slot& slot) const {
  slot.is_taken = true;
  slot.n_unseen = 0;
  slot.x_um = touch.x_um;
  slot.y_um = touch.y_um;
  std::rotate(slot.press_un.begin(), slot.press_un.end() - 1, slot.press_un.end());
  slot.press_un[0] = touch.press_un;
  slot.n_frames = std::min(slot.n_frames + 1, averaged_frames_);
  int64_t sum = 0;
  for (int i = 0; i < slot.n_frames; ++i) sum += slot.press_un[static_cast<size_t>(i)];
  touch.press_un = floor_div(2 * sum + slot.n_frames, int64_t{2} * slot.n_frames);
  touch.id = slot.id;
}

void SkinTrack::run(SkinTouchList& list) {
  for (Slot& slot : slots_) {
    slot.is_taken = false;
    if (slot.id != 0 && slot.n_unseen++ > kMaxUnseenFrames) slot = {};
  }
  for (int i = 0; i < list.n_listed; ++i) list.touch[static_cast<size_t>(i)].id = 0;
  for (int round = 0; round < list.n_listed; ++round) {
    int64_t least = kReachUm * kReachUm + 1;
    SkinTouch* touch = nullptr;
    Slot* slot = nullptr;
    for (int i = 0; i < list.n_listed; ++i) {
      SkinTouch& candidate = list.touch[static_cast<size_t>(i)];
      if (candidate.id != 0) continue;
      for (Slot& other : slots_) {
        if (other.id == 0 || other.is_taken || distance2(candidate, other) >= least) continue;
        least = distance2(candidate, other);
        touch = &candidate;
        slot = &other;
      }
    }
    if (touch == nullptr) break;
    follow(*touch, *slot);
  }
  for (int i = 0; i < list.n_listed; ++i) {
    SkinTouch& touch = list.touch[static_cast<size_t>(i)];
    if (touch.id == 0) follow(touch, begin());
  }
}

}  // namespace ruffini
