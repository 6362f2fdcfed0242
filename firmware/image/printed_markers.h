// The printed markers of a board: dots, which is which, and each by all its ink.
// Frame thread; no allocation after the constructor.
#pragma once

#include <span>
#include <vector>

#include "image/dot_templates.h"
#include "image/dots.h"
#include "image/markers.h"

namespace ruffini {

class PrintedMarkers {
 public:
  explicit PrintedMarkers(const BoardSettings& board);

  // From the rest image, its grey as of image/difference.h and its colours in 1/16 levels. Number of markers found.
  int learn(std::span<const uint16_t> grey, std::span<const uint16_t> rest);
  // Follow one frame and its grey. Number of markers lost that were there at rest.
  int track(std::span<const uint16_t> grey, const FrameView& frame);

  // Markers, dirt and all.
  [[nodiscard]] int n_dots_at_rest() const { return n_dots_at_rest_; }
  [[nodiscard]] std::span<const Marker> markers() const { return tracker_.markers(); }

 private:
  DotDetector dots_;
  MarkerTracker tracker_;
  DotTemplates templates_;
  std::vector<int64_t> error2_q16_;
  int n_dots_at_rest_ = 0;
};

}  // namespace ruffini
