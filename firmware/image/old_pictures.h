// Pictures, or parts of them, that the camera gave before: for live cameras.
//
//   cell:  a quarter of the width of a band of rows; bands are multiples of 8 rows, 30 of them at most, or about that
//   sum(c) = hash of kSamples pixels of cell c that are drawn once; a cell whose samples are on average black or white
//            (kBlack, kWhite) shows nothing and is not compared
//   old:   the same sum in at least kFewest cells as in one of the last kRemembered pictures
//
// Noise never repeats in kSamples pixels. A driver has at most 32 buffers (VIDEO_MAX_FRAME): that many are looked through.
// Two cells of one older picture are wanted, as a camera that compresses hard may repeat a flat one. A camera whose cells repeat
// while rest is learned has no noise: then only pictures count all of whose cells are as before.
//
// What tears off less than two cells, 7 % of the picture as a quarter-wide column or two quarters of a band, is not seen.
// Frame thread; no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

class OldPictures {
 public:
  OldPictures(int width_px, int height_px);

  // Rest is learned anew from here on.
  void begin_rest();
  // A picture of rest: remembered, and whether this camera repeats itself.
  void add_rest(const FrameView& frame);
  // Whether the picture or a part of it is an old one. It is remembered, too.
  [[nodiscard]] bool run(const FrameView& frame);

 private:
  static constexpr int kColumns = 4;
  static constexpr size_t kSamples = 16;
  static constexpr size_t kRemembered = 31;
  static constexpr int kFewest = 2;
  using Cells = std::vector<uint64_t>;  // sum of each; 0: shows nothing

  struct Repeats {
    int most = 0;           // cells of one older picture
    bool is_whole = false;  // all of one that shows anything
  };
  void sum(const FrameView& frame);
  [[nodiscard]] Repeats compare() const;
  void remember();

  int band_rows_;
  int n_bands_;
  std::vector<std::array<int32_t, 2>> at_;  // column and row of each sample, cell by cell
  Cells now_;
  std::vector<Cells> before_;  // a ring
  size_t n_before_ = 0;
  size_t next_ = 0;
  bool repeats_itself_ = false;
};

}  // namespace ruffini
