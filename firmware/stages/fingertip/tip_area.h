// Area of a fingertip's wall that lies flat under a tool, and the area of the tool's face if its whole edge bears.
//
//   h_ki = t . (R_tip g_ki + f(g_ki))     heights along the tool's axis t on rays k and rings i around the touch
//   flat area = sum of cells with h > top - 0.3 mm; top: mean of the highest 6 mm^2. No fit. Its deviation: half of the
//               change caused by +-0.07 mm of height
//   key points: on each ray the highest ring, and the one with the largest curvature, h_(i+2) - 2 h_i + h_(i-2)
//   radii     : sqrt(mean over rays of r_k r_(k+1)) of either
//   face      : table of a Gaussian process over force, travel and both radii, interpolated linearly in all four: area,
//               its relative deviation, and the probability that the whole edge bears. Reported from 0.7 on.
//
// Lengths in 1/16 um, directions in Q14. Needs both eyes. Frame thread; no allocation after load().
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "base/result.h"
#include "stages/fingertip/tip_field.h"
#include "store/calibration.h"

namespace ruffini {

struct TipAreas {
  int64_t flat_area_um2 = 0;  // 0: not measured
  int64_t flat_area_sigma_um2 = 0;
  int64_t face_um2 = 0;  // 0: not known
  int64_t face_sigma_um2 = 0;
};

class TipArea {
 public:
  static constexpr size_t kRays = 24;
  static constexpr size_t kRings = 21;  // the first is the middle, the others half a millimetre apart
  static constexpr size_t kInputs = 4;
  static constexpr size_t kOutputs = 3;

  // Returns no value if the calibration has no such tables. Errors: kBadInput.
  [[nodiscard]] static Result<std::optional<TipArea>> load(const Calibration& calibration);

  // Call after field.run(). axis_1e6: the tool's axis, pointing out of the fingertip.
  TipAreas run(const TipField& field, const TipField::Vector& axis_1e6, int64_t force_un, int64_t travel_um);

 private:
  struct Axis {
    int64_t zero = 0;
    int64_t step = 1;
    int64_t count = 2;
  };
  struct Key {
    std::array<int64_t, kRays> ridge{};  // rings
    std::array<int64_t, kRays> bend{};
  };
  void find_heights(const TipField& field, const TipField::Vector& axis_1e6);
  [[nodiscard]] int64_t find_top();
  [[nodiscard]] int64_t area_above(int64_t height) const;
  [[nodiscard]] Key key_points() const;
  [[nodiscard]] std::array<int64_t, kOutputs> look_up(const std::array<int64_t, kInputs>& at) const;

  std::vector<TipField::Vector> ray_;   // [kRays][kRings]
  std::array<int64_t, kRings> cell_{};  // um^2
  int64_t tip_ = 0;                     // radius of the sphere of pin tips
  std::array<Axis, kInputs> axis_{};
  std::vector<int32_t> table_;  // [inputs ...][kOutputs]: 1e-3 mm^2, Q16, Q16
  std::vector<int64_t> height_;
  std::vector<size_t> order_;
};

}  // namespace ruffini
