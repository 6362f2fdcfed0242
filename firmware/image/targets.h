// Round dark targets on the tray that carries the pad: centre and area of each, against rest.
//
//   coarse    mean of 4 x 4 pixels of grey; image/dots.h finds and labels spots that are dark against their surroundings
//   identity  a target is the spot nearest to its place in the rest picture, within its own radius: it keeps its number
//   sight     image/disc_edge.h
//
// A target that has no spot, or too few edges, is lost; spots at the picture's border are not seen. Frame thread; no
// allocation after the constructor. Not in the paper, which counts the pixels below one level.
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
  DiscSight rest;
  DiscSight now;  // of a lost one: as it was last seen
  bool is_lost = true;
};

class TargetTracker {
 public:
  explicit TargetTracker(const BoardSettings& board);

  // Rest: each target near its place on the board. Returns how many there are.
  int learn(std::span<const uint16_t> grey);
  // Returns how many are lost.
  int track(std::span<const uint16_t> grey);

  [[nodiscard]] std::span<const Target> targets() const { return targets_; }
  // Half of the seen targets stand in light that is a quarter brighter or darker than at rest.
  [[nodiscard]] bool is_light_off() const;

 private:
  void find_spots(std::span<const uint16_t> grey);
  [[nodiscard]] DiscSight sight(std::span<const uint16_t> grey, const DiscSight& expected);

  int width_px_;
  GridSize coarse_size_;
  std::vector<DiscSight> places_;  // as the board says
  std::vector<Target> targets_;
  std::vector<uint16_t> coarse_;
  DotDetector spots_;
  std::span<const Dot> found_;
  DiscEdge edge_;
};

}  // namespace ruffini
