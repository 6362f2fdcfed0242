// Detects pictures, or parts of them, that a live camera has delivered before.
//
//   cell    a quarter of the width of a band of rows; about 30 bands, each a multiple of 8 rows
//   hash(c) of kSamples pixels of cell c, whose places are drawn once: the upper half of the sum of (BGR + 1) kMix^i
//           modulo 2^64. Cells that are black or white on average (kBlack, kWhite) are not compared
//   quiet   a cell that has repeated, alone of all cells, since rest was learned: dark, or flattened by compression
//   old     at least kMinCells cells that are not quiet have the hash that they had in one of the last kRemembered
//           pictures, or all cells have
//
// Sensor noise makes an equal hash of kSamples pixels practically impossible, also in a fingertip's dark cells, where
// 12 pixels do not suffice. A V4L2 driver has at most 32 buffers (VIDEO_MAX_FRAME), so an old buffer is among the last
// 31 pictures. Two cells are required because strong compression may repeat a flat cell. If cells repeat among the rest
// frames, the camera has no noise: then only a picture that is equal in all cells counts as old; likewise after a rest
// of one frame that had no older one to compare with.
//
// In 3,577 recorded frames of a camera that compresses (MJPEG), two cells repeat in 58 frames, all of them in four dark
// cells; without quiet ones in 4.
// Limit: an old part that covers less than two whole cells is not detected.
// Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

class RepeatedPictures {
 public:
  RepeatedPictures(int width_px, int height_px);

  // Starts a new rest image: whether the camera repeats itself is unknown again.
  void begin_rest();
  // True if the picture or a part of it is an old one. Remembers it.
  bool run(const FrameView& frame);
  // The picture of the last run() is a rest frame: records whether this camera repeats itself.
  void count_as_rest() {
    if (last_.n_older > 0) repeats_itself_ = repeats_itself_.value_or(false) || last_.most > 0;
  }

 private:
  static constexpr int kColumns = 4;
  static constexpr size_t kSamples = 16;
  static constexpr size_t kRemembered = 31;
  static constexpr int kMinCells = 2;
  using Cells = std::vector<uint32_t>;  // hash of each; 0: shows nothing

  struct Repeats {
    size_t n_older = 0;     // pictures that it was compared with
    int most = 0;           // cells of one older picture, without quiet ones
    size_t cell = 0;        // one of these
    bool is_whole = false;  // all of one that shows anything
  };
  void sum(const FrameView& frame);
  [[nodiscard]] Repeats compare() const;
  // Enters the cells that repeat an older picture's, if they are more than those found so far.
  void count_loud(const Cells& older, Repeats& found) const;
  void remember();

  int band_rows_;
  int n_bands_;
  std::vector<std::array<int32_t, 2>> at_;  // first byte in its row, and row, of each sample, cell by cell
  std::vector<ptrdiff_t> offset_;           // of each sample in a picture of stride_
  ptrdiff_t stride_ = 0;
  Cells now_;
  std::vector<uint8_t> is_quiet_;  // per cell
  std::vector<Cells> before_;      // a ring
  size_t n_before_ = 0;
  size_t next_ = 0;
  Repeats last_;
  std::optional<bool> repeats_itself_ = false;  // no value: not known yet
};

}  // namespace ruffini
