// What presses on a round fingertip whose pins two eyes follow: a tool that came down along its own axis.
//
//   features about the touched place (tip_field.h) -> small network (tip_net.h) -> force, way, the tool's axis t' and
//   place o' in the turned frame, side of the square of its face's area, and how sure of each; beside it the areas of
//   tip_area.h, whose word about the face is told where the network's is not sure. Turned back:
//   t = R^T t', roll = atan2(-t_y, |(t_x, t_z)|), pitch = atan2(t_x, t_z), (x, y, .) = T^T R^T o', T = pitch after roll
//
// Deviations: 2^q in a straight line between whole q, times `trust`. Frame thread; no allocation after load().
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
  // Kind "fingertip" of the calibration. Errors: kBadInput.
  [[nodiscard]] static Result<Fingertip> load(const Calibration& calibration);

  void learn(std::span<const Marker> markers);
  // The eyes that saw anything at rest have fewer than half of the calibrated pins: another fingertip.
  [[nodiscard]] bool is_other_pad(Eyes eyes) const { return 2 * field_.n_pins_there(eyes) < field_.n_pins(); }
  [[nodiscard]] size_t n_pins() const { return static_cast<size_t>(field_.n_pins()); }
  TipTouch run(std::span<const Marker> markers, Eyes eyes, SaturationCounter& saturations);
  // Pins of the last frame that one eye must have seen wrong: nobody knows which.
  [[nodiscard]] int n_contradicted() const { return field_.n_contradicted(); }

 private:
  static constexpr size_t kQuantities = 7;
  using Numbers = std::array<int64_t, kQuantities>;
  explicit Fingertip(TipField field) : field_(std::move(field)) {}
  void turn_back(const Numbers& value, TipTouch& touch) const;

  void tell_areas(TipTouch& touch);
  [[nodiscard]] TipTouch tell(std::span<const Marker> markers, Eyes eyes, SaturationCounter& saturations);

  TipField field_;
  std::array<RimMotion, TipField::kEyes> rim_;
  std::optional<TipArea> area_;
  std::vector<TipNet> nets_;  // one for each of Eyes
  Numbers zero_{};            // uN, um, um, um, 1e-6, 1e-6, um
  Numbers scale_{};
  std::vector<Numbers> trust_q8_;
  int64_t most_un_ = 0;
};

}  // namespace ruffini
