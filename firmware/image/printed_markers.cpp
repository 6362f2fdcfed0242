#include "image/printed_markers.h"

namespace ruffini {

PrintedMarkers::PrintedMarkers(const BoardSettings& board)
    : dots_(dot_parameters(board)),
      tracker_(board),
      templates_(board),
      error2_q16_(static_cast<size_t>(board.markers.lattice.count())) {}

int PrintedMarkers::learn(std::span<const uint16_t> grey, std::span<const uint16_t> rest) {
  const std::span<const Dot> dots = dots_.detect(grey);
  n_dots_at_rest_ = static_cast<int>(dots.size());
  const int n_found = tracker_.learn(dots);
  templates_.learn(rest, tracker_.markers());
  return n_found;
}

int PrintedMarkers::track(std::span<const uint16_t> grey, const FrameView& frame) {
  const std::span<Marker> markers = tracker_.assign(dots_.detect(grey));
  templates_.refine(frame, markers, error2_q16_);
  return tracker_.finish(error2_q16_);
}

}  // namespace ruffini
