// The checks on a live camera's picture that run before any stage uses it. Frame thread.
#pragma once

#include <span>

#include "image/block_edges.h"
#include "image/frame_watch.h"
#include "image/pixel_statistics.h"
#include "image/repeated_pictures.h"

namespace ruffini {

struct PictureWatch {
  PictureWatch(int width_px, int height_px)
      : frame(width_px, height_px),
        repeated(width_px, height_px),
        pixels(width_px, height_px),
        blocks(width_px, height_px) {}

  // Order of calls: begin_rest(), repeated.run() and add_rest() for each rest frame, then learn() with the rest image.
  // The image may also come from a file or another path; then learn() alone is called.
  void begin_rest() {
    repeated.begin_rest();
    pixels.begin_rest();
    blocks.begin_rest();
  }
  void add_rest(const FrameView& rest) {
    repeated.count_as_rest();
    pixels.add_rest(rest);
    blocks.add_rest(rest);
  }
  void learn(std::span<const uint16_t> rest) {
    frame.learn(rest);
    pixels.learn(rest);
  }

  FrameWatch frame;
  RepeatedPictures repeated;
  PixelStatistics pixels;
  BlockEdges blocks;
};

}  // namespace ruffini
