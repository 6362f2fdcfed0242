// Takes frames through the segments of a path (core/stages.h), by one frame thread or two: a segment holds one frame,
// and frames keep their order. No lock.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "base/turnstile.h"
#include "frame_path.h"

namespace ruffini {

// Frames are numbered from 0 without gaps. All calls of a frame come in this order; a thread may hand it to another.
class SegmentTurns {
 public:
  // Returns when the frame may begin in the first segment, and at most one before it has not ended.
  void wait_to_begin(const FramePath& path, uint32_t number) {
    wait_for_previous(path, number - 1);
    turns_[0].wait_for(number);
  }
  // Returns when the previous frame has ended.
  void wait_for_previous(const FramePath& path, uint32_t number) { turns_[path.n_segments() - 1].wait_for(number); }
  // Runs the frame's segment and those after it, before `until`, into which the frame must be taken by enter().
  // Waits where the frame before still has one of them.
  void run(FramePath& path, Frame& frame, uint32_t number, size_t until) {
    path.run(frame.segment, frame);
    while (++frame.segment < until) {
      enter(path, frame, number);
      path.run(frame.segment, frame);
    }
  }
  // Returns when the frame has its next segment: the next frame may then have the ones before.
  void enter(FramePath& path, Frame& frame, uint32_t number) {
    turns_[frame.segment].wait_for(number);
    path.enter(frame.segment, frame);
    if (!frame.is_alone) turns_[frame.segment - 1].pass();
  }
  // The frame has ended: its results are no longer read.
  void end(const FramePath& path, const Frame& frame) {
    for (size_t segment = frame.is_alone ? 0 : path.n_segments() - 1; segment < path.n_segments(); ++segment) {
      turns_[segment].pass();
    }
  }

 private:
  std::array<Turnstile, kMaxSegments> turns_{};
};

}  // namespace ruffini
