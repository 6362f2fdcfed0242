// Printed markers of a board: detects dots, identifies markers, and refines each marker by all its pixels. Several
// views side by side in one frame ([markers] layout "views") are tracked independently: a marker lost in one view may
// still be seen in the others. Markers are listed view by view, in the frame's pixels. Frame thread; no allocation
// after the constructor.
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

  // Learns from the rest image: its grey as in image/difference.h, its colours in 1/16 levels. Returns the number of
  // markers found.
  int learn(std::span<const uint16_t> grey, std::span<const uint16_t> rest);
  // Tracks one frame and its grey. Returns the number of lost markers that were there at rest.
  int track(std::span<const uint16_t> grey, const FrameView& frame);

  // Number of dots at rest, dirt included.
  [[nodiscard]] int n_dots_at_rest() const { return n_dots_at_rest_; }
  [[nodiscard]] std::span<const Marker> markers() const { return markers_; }
  [[nodiscard]] size_t n_views() const { return views_.size(); }
  // Number of markers of one view that were there at rest and are lost, or have low confidence, in the last frame.
  [[nodiscard]] int n_low_confidence(size_t view) const;
  // True if the rest image shows at least half of the view's markers.
  [[nodiscard]] bool was_seen_at_rest(size_t view) const {
    return 2 * static_cast<size_t>(views_[view].n_at_rest) >= n_per_view_;
  }

 private:
  struct View {
    MarkerTracker tracker;
    int64_t left_q16 = 0;  // left edge in the frame's pixels
    int n_at_rest = 0;
    std::vector<Dot> dots{};
    std::span<Marker> own{};  // of the tracker, for refinement
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
