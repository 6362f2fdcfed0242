// Rest image: mean of the first untouched frames, and the tables that later stages derive from it.
//
//   rest = (16 sum + n / 2) / n          per channel, 1/16 grey level, uint16
//   reciprocal = (2^24 + floor / 2) / floor, floor = max(rest, 512), at most 2^15 - 1
//
// With a dark frame (picture with the lamps off: black level, daylight) only rest - dark is due to the lamps: it
// replaces rest in the reciprocal, and the gain applies to it alone.
//
// Below 32 grey levels (512) a ratio is unreliable and could exceed the 16 bits of RelativeChange. A gain per channel
// (image/light.h), times a factor between nodes 16 px apart (image/light_map.h; bilinear, half up), adapts the image to
// other light: rest * gain, reciprocal / gain. A new gain applies at once, a new map row by row within 16 frames.
//
// Frame thread; no allocation after the constructor.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"

namespace ruffini {

class Rest {
 public:
  using Gain = std::array<int32_t, 3>;  // of B, G, R, Q20; from 0.75 to 1.25
  static constexpr int32_t kUnitGain = 1 << 20;
  static constexpr Gain unit_gain() { return {kUnitGain, kUnitGain, kUnitGain}; }

  static constexpr int kNodePx = 16;
  // Nodes of a map; the last ones are beyond the last pixel.
  static GridSize map_nodes(int width_px, int height_px) {
    return {(width_px - 1) / kNodePx + 2, (height_px - 1) / kNodePx + 2};
  }
  // Clamps to the range of a gain.
  static int32_t clamp_gain(int64_t gain) {
    return static_cast<int32_t>(std::clamp<int64_t>(gain, kUnitGain * 3 / 4, kUnitGain * 5 / 4));
  }

  static constexpr int kMaxFrames = 256;  // board.toml's and the protocol's limit; their sum fits 16 bits

  Rest(int width_px, int height_px, int n_frames);

  // Learns a new rest image from the next n frames (0: the number given at construction), kMaxFrames at most.
  void restart(int n_frames);
  // Cancels learning: the previous rest image is in force again. If there was none, learning starts over.
  void cancel_learning();
  // Sets a stored image, width x height x 3 in 1/16 grey levels.
  void load(std::span<const uint16_t> image);
  // Adds one untouched frame. Returns true if it completed the mean.
  bool add(const FrameView& frame);

  // Sets the picture without lamps, width x height x 3 in 1/16 grey levels; empty: none.
  void set_dark(std::span<const uint16_t> image);

  // Sets the light relative to the image; a new image starts from 1 again.
  void set_gain(const Gain& gain);
  // Sets the factor on the gain at every node, planes of B, G and R, Q20. It is in force after 16 calls of advance().
  void set_map(std::span<const int32_t> factor);
  // Call once a frame: applies the map to a 16th of the rows.
  void advance();

  [[nodiscard]] bool is_ready() const { return is_ready_; }
  [[nodiscard]] bool is_relearning() const { return !is_ready_ && has_image_; }
  [[nodiscard]] std::span<const uint16_t> image() const { return image_; }
  // Planes of B, G and R, in the format of difference.h.
  [[nodiscard]] std::span<const int16_t> planes8() const { return planes8_; }
  [[nodiscard]] std::span<const int16_t> reciprocal() const { return reciprocal_; }

 private:
  void finish();
  void find_node_gains();
  void take_rows(int from, int to);
  void take_cells(size_t channel, int y, int first_x);
  void find_unit_reciprocals();
  // Of a value of the image.
  [[nodiscard]] int32_t unit_reciprocal(size_t i) const;
  [[nodiscard]] uint16_t dark(size_t i) const { return dark_.empty() ? uint16_t{0} : std::min(dark_[i], image_[i]); }

  int width_px_;
  int height_px_;
  int n_frames_;
  int n_wanted_;
  int n_added_ = 0;
  bool is_ready_ = false;
  bool has_image_ = false;  // remains set while another image is learned
  std::vector<uint16_t> image_;
  std::vector<uint16_t> dark_;    // at most the image; empty: 0
  std::vector<int16_t> planes8_;  // 8 times the rest image
  std::vector<int16_t> reciprocal_;
  // At gain 1, planes like the others; while an image is learned its room holds the sums of the frames, interleaved
  std::vector<uint16_t> unit_reciprocal_;
  GridSize nodes_;
  Gain gain_ = unit_gain();
  std::vector<int32_t> factor_;
  std::vector<int32_t> node_gain_;  // Q20
  std::vector<int32_t> node_inverse_q14_;
  std::vector<int32_t> row_gain_;  // at the nodes of one row of pixels
  std::vector<int32_t> row_inverse_q14_;
  int next_row_ = 0;  // equals the height when all rows have the map
};

}  // namespace ruffini
