#include "image/printed_markers.h"

#include <algorithm>

namespace ruffini {
namespace {

// Settings of one view as a board of its own.
BoardSettings view_board(const BoardSettings& board) {
  if (!board.markers.has_views) return board;
  BoardSettings one = board;
  one.camera.width_px = board.camera.width_px / board.markers.lattice.n_y;
  one.markers.lattice.n_y = 1;
  return one;
}

ImagePx moved(ImagePx at, int64_t by_q16) { return ImagePx::from_raw(static_cast<int32_t>(at.raw() + by_q16)); }

}  // namespace

PrintedMarkers::PrintedMarkers(const BoardSettings& board)
    : dots_(dot_parameters(board)),
      templates_(board),
      markers_(static_cast<size_t>(board.markers.lattice.count())),
      error2_q16_(markers_.size()) {
  const BoardSettings one = view_board(board);
  view_width_q16_ = int64_t{one.camera.width_px} << 16;
  n_per_view_ = static_cast<size_t>(one.markers.lattice.count());
  const int n_views = board.markers.has_views ? board.markers.lattice.n_y : 1;
  for (int i = 0; i < n_views; ++i) {
    views_.push_back({.tracker = MarkerTracker(one), .left_q16 = i * view_width_q16_});
    views_.back().dots.reserve(DotDetector::kMaxDots);
  }
}

// Assigns each dot to its view, in that view's pixels.
void PrintedMarkers::share_out(std::span<const Dot> dots) {
  for (View& view : views_) {
    view.dots.clear();
    for (const Dot& dot : dots) {
      const int64_t x = dot.x.raw() - view.left_q16;
      if (x >= 0 && x < view_width_q16_) view.dots.push_back({moved(dot.x, -view.left_q16), dot.y, dot.area_px});
    }
  }
}

// Collects the markers of all views, in the frame's pixels.
void PrintedMarkers::gather() {
  auto out = markers_.begin();
  for (const View& view : views_) {
    for (Marker marker : view.tracker.markers()) {
      marker.rest_x = moved(marker.rest_x, view.left_q16);
      *out++ = marker;
    }
  }
}

int PrintedMarkers::learn(std::span<const uint16_t> grey, std::span<const uint16_t> rest) {
  const std::span<const Dot> dots = dots_.detect(grey);
  n_dots_at_rest_ = static_cast<int>(dots.size());
  share_out(dots);
  int n_found = 0;
  for (View& view : views_) {
    view.n_at_rest = view.tracker.learn(view.dots);
    n_found += view.n_at_rest;
  }
  gather();
  templates_.learn(rest, markers_);
  return n_found;
}

int PrintedMarkers::track(std::span<const uint16_t> grey, const FrameView& frame) {
  share_out(dots_.detect(grey));
  for (View& view : views_) view.own = view.tracker.assign(view.dots);
  gather();
  templates_.refine(frame, markers_, error2_q16_);
  int n_lost = 0;
  size_t first = 0;
  for (View& view : views_) {
    for (size_t i = 0; i < n_per_view_; ++i) {
      view.own[i].displacement_x = markers_[first + i].displacement_x;
      view.own[i].displacement_y = markers_[first + i].displacement_y;
    }
    n_lost += view.tracker.finish(std::span<const int64_t>(error2_q16_).subspan(first, n_per_view_));
    first += n_per_view_;
  }
  gather();
  return n_lost;
}

int PrintedMarkers::n_low_confidence(size_t view) const {
  const std::span<const Marker> own = views_[view].tracker.markers();
  return static_cast<int>(
      std::count_if(own.begin(), own.end(), [](const Marker& m) { return !m.is_absent && !m.is_confident(); }));
}

}  // namespace ruffini
