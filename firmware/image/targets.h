// Round dark targets on the tray that carries the pad: centre and area of each, relative to rest.
//
//   coarse    mean of 4 x 4 pixels of grey; image/dots.h finds and labels dark spots
//   identity  a target is the spot nearest to its rest position, within its own radius, and keeps its number
//   measure   image/disc_edge.h
//
// A target without a spot, or with too few edges, is lost; spots at the picture's border are not detected. Frame
// thread; no allocation after the constructor. Not in the paper, which counts the pixels below one level.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "image/disc_edge.h"
#include "image/dots.h"

namespace ruffini {

struct Target {
  DiscMeasurement rest;
  DiscMeasurement now;  // if lost: as it was last seen
  bool is_lost = true;
};

class TargetTracker {
 public:
  explicit TargetTracker(const BoardSettings& board);

  // Finds each target near its position on the board, at rest. Returns the number found.
  int learn(std::span<const uint16_t> grey);
  // Returns the number of lost targets.
  int track(std::span<const uint16_t> grey);

  [[nodiscard]] std::span<const Target> targets() const { return targets_; }
  // True if half of the visible targets are a quarter brighter or darker than at rest.
  [[nodiscard]] bool is_light_wrong() const;

 private:
  void find_spots(std::span<const uint16_t> grey);
  [[nodiscard]] DiscMeasurement measure(std::span<const uint16_t> grey, const DiscMeasurement& expected);

  int width_px_;
  GridSize coarse_size_;
  std::vector<DiscMeasurement> places_;  // positions given by the board
  std::vector<Target> targets_;
  std::vector<uint16_t> coarse_;
  DotDetector spots_;
  std::span<const Dot> found_;
  DiscEdge edge_;
};

}  // namespace ruffini
