// Estimates the touch of a tool that came down along its own axis on a round fingertip whose pins are seen by two eyes
// (cameras).
//   features about the touched place (tip_field.h) -> small network (tip_net.h) -> force, travel, the tool's axis t'
//   and position o' in the rotated frame, side of the square with its face's area, and the uncertainty of each; also
//   the areas of tip_area.h, whose face area is reported if the network's is too uncertain. Rotated back:
//   t = R^T t', roll = atan2(-t_y, |(t_x, t_z)|), pitch = atan2(t_x, t_z), (x, y, .) = T^T R^T o', T = pitch after roll
//
// Standard deviations: 2^q, interpolated linearly between whole q, times `trust`. Frame thread; no allocation after
// load().
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "base/result.h"
#include "core/results.h"
#include "stages/fingertip/rim_motion.h"
#include "stages/fingertip/tip_area.h"
#include "stages/fingertip/tip_field.h"
#include "stages/fingertip/tip_net.h"
#include "store/calibration.h"

namespace ruffini {

class Fingertip {
 public:
  // Loads kind "fingertip" of the calibration. Errors: kBadInput.
  [[nodiscard]] static Result<Fingertip> load(const Calibration& calibration);

  void learn(std::span<const Marker> markers);
  // True if the eyes that saw anything at rest show fewer than half of the calibrated pins: a different fingertip.
  [[nodiscard]] bool is_other_pad(Eyes eyes) const { return 2 * field_.n_pins_there(eyes) < field_.n_pins(); }
  [[nodiscard]] size_t n_pins() const { return static_cast<size_t>(field_.n_pins()); }
  TipTouch run(std::span<const Marker> markers, Eyes eyes, SaturationCounter& saturations);
  // Number of pins in the last frame whose two views contradict each other; which eye is wrong is unknown.
  [[nodiscard]] int n_contradicted() const { return field_.n_contradicted(); }

 private:
  static constexpr size_t kQuantities = 7;
  using Numbers = std::array<int64_t, kQuantities>;
  explicit Fingertip(TipField field) : field_(std::move(field)) {}
  void rotate_back(const Numbers& value, TipTouch& touch) const;

  void estimate_areas(TipTouch& touch);
  [[nodiscard]] TipTouch estimate(std::span<const Marker> markers, Eyes eyes, SaturationCounter& saturations);

  TipField field_;
  std::array<RimMotion, TipField::kEyes> rim_;
  std::optional<TipArea> area_;
  std::vector<TipNet> nets_;  // one for each value of Eyes
  Numbers zero_{};            // uN, um, um, um, 1e-6, 1e-6, um
  Numbers scale_{};
  std::vector<Numbers> trust_q8_;
  int64_t max_un_ = 0;
};

}  // namespace ruffini
