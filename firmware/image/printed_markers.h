// The printed markers of a board: dots, which is which, and each by all its ink.
// Several views side by side in one frame ([markers] layout "views") are followed each for itself: what one of them
// loses, the others still have. Their markers come view by view, in the frame's pixels.
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
  [[nodiscard]] std::span<const Marker> markers() const { return markers_; }
  [[nodiscard]] size_t n_views() const { return views_.size(); }
  // Of one view: markers that were there at rest and are lost, or not sure, in the last frame.
  [[nodiscard]] int n_unsure(size_t view) const;
  // The rest image shows at least half of its markers.
  [[nodiscard]] bool was_seen_at_rest(size_t view) const {
    return 2 * static_cast<size_t>(views_[view].n_at_rest) >= n_per_view_;
  }

 private:
  struct View {
    MarkerTracker tracker;
    int64_t left_q16 = 0;  // of the frame's pixels
    int n_at_rest = 0;
    std::vector<Dot> dots{};
    std::span<Marker> own{};  // the tracker's, to be refined
  };
  void share_out(std::span<const Dot> dots);
  void gather();

  DotDetector dots_;
  int64_t view_width_q16_;
  size_t n_per_view_;
  std::vector<View> views_;
  DotTemplates templates_;
  std::vector<Marker> markers_;
  std::vector<int64_t> error2_q16_;
  int n_dots_at_rest_ = 0;
};

}  // namespace ruffini
