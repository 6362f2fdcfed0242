// Mean light of round spots relative to rest, for cameras that look at ends of optical fibres or at glowing taxels:
// features of a wrench.
//
//   place   [markers] of the board through its pinhole, then centroid at rest of max(grey - (lowest + highest) / 2, 0)
//           over a square of a pitch about it; 1/256 px
//   r_k     2^16 (sum of grey over spot k) / (the same at rest), half up; a pixel belongs to the spot if its centre is
//           at most half of [markers] diameter_um from the place
//   f_k     2^20 r_k / g - 2^16, half up                                                    Q16 of rest, below 2^21
//   group   most seen spots whose f are within 2 % of each other (of equal groups the lowest f); m is element n / 2 of
//           its n, sorted by f. If it has at least half of the seen spots, the others are what a press changes, and
//           |m| > 4 % is changed light (six times the noise of a spot of 80 pixels is 1 %)
//   still   the group is all seen spots, |m| <= 4 %, not too many spots are lost, and no flag says that the frame is
//           wrong
//   g      += clamp(m, +-1/128) / 16 in every frame from the 16th still one on; Q20, 0.75 to 1.25. It follows lamps
//           that age, and starts from 1 with a new rest picture. image/light.h is not used: it would take a press that
//           brightens an eighth of the picture for daylight
//   lost    a fibre that is broken or too bright: an eighth of its pixels at 255, or below 16 grey levels at rest, or
//           now
//           below a 16th of its light at rest. Its f is the mean, half up, of the seen ones among the kNear nearest
//           spots, else 0
//
// A press on all spots alike is indistinguishable from light: less than 4 %, or slower than 0.05 % a frame, is learned,
// up to 25 %. Light that changes while a press reaches more than half of the spots is not noticed. Not in the papers.
// Frame thread; one pass over the spots' pixels, no allocation after the constructor.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "base/image_view.h"
#include "board/settings.h"

namespace ruffini {

class SpotIntensities {
 public:
  static constexpr size_t kNear = 6;
  static constexpr int64_t kOne = 1 << 16;

  struct Outcome {
    int n_lost = 0;
    bool is_light_wrong = false;  // half of the spots agree on a light that is more than 4 % off
  };

  explicit SpotIntensities(const BoardSettings& board);

  // False if [markers] does not say where the spots are.
  [[nodiscard]] bool has_places() const { return !nominal_.empty(); }
  // `grey`: of the rest picture (image/difference.h), width x height; `rest`: its pixels, 1/16 levels of B, G, R.
  void learn(std::span<const uint16_t> grey, std::span<const uint16_t> rest);
  // `features`: one for each spot, in the order of [markers]. `is_wrong`: nothing is learned from this frame.
  Outcome run(std::span<const uint16_t> grey, const FrameView& frame, std::span<int32_t> features, bool is_wrong);

 private:
  struct Place {
    int64_t x_q8 = 0;
    int64_t y_q8 = 0;
  };
  struct Run {
    int y = 0;
    int first = 0;
    int last = 0;
  };
  struct Spot {
    size_t first_run = 0;
    size_t n_runs = 0;
    int64_t n_pixels = 0;
    int64_t rest = 0;  // sum of grey
    bool is_usable = false;
    std::array<size_t, kNear> near{};
  };

  [[nodiscard]] Place found(const Place& nominal, std::span<const uint16_t> grey) const;
  void cover(Spot& spot, const Place& place);
  void find_near();
  [[nodiscard]] int64_t sum(const Spot& spot, std::span<const uint16_t> grey) const;
  Outcome follow(std::span<const int32_t> features, bool is_wrong);
  void fill(std::span<int32_t> features) const;

  int width_px_;
  int height_px_;
  int64_t radius_q8_;
  int64_t reach_x_q8_;  // half a pitch
  int64_t reach_y_q8_;
  int max_lost_;
  std::vector<Place> nominal_;
  std::vector<Spot> spot_;
  std::vector<Run> run_;
  std::vector<uint8_t> is_lost_;
  std::vector<int32_t> sorted_;
  int64_t gain_q20_ = 1 << 20;
  int n_still_ = 0;
};

}  // namespace ruffini
