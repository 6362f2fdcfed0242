// How much of a fingertip's wall lies flat under a tool, and how large that tool's face is where its edge bears.
//
//   h_ki = t . (R_tip g_ki + f(g_ki))     heights along the tool's axis t on rays k and rings i about the touched place
//   flat area = sum of cells with h > top - 0.3 mm; top: mean of the highest 6 mm^2. Nothing is fitted. Its deviation:
//               half of what +-0.07 mm of height change
//   key points: on each ray the highest ring, and the one where h bends most, h_(i+2) - 2 h_i + h_(i-2)
//   radii     : sqrt(mean over rays of r_k r_(k+1)) of either
//   face      : table of a Gaussian process over force, way and both radii, straight between its places in four ways:
//               area, its deviation as a part of it, and how likely the whole edge bears. Told from 0.7 on.
//
// Lengths 1/16 um, directions Q14. Both eyes only. Frame thread; no allocation after load().
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
  int64_t flat_um2 = 0;  // 0: not measured
  int64_t flat_sigma_um2 = 0;
  int64_t face_um2 = 0;  // 0: not known
  int64_t face_sigma_um2 = 0;
};

class TipArea {
 public:
  static constexpr size_t kRays = 24;
  static constexpr size_t kRings = 21;  // the first is the middle, the others half a millimetre apart
  static constexpr size_t kInputs = 4;
  static constexpr size_t kOutputs = 3;

  // Nothing where the calibration has no such tables. Errors: kBadInput.
  [[nodiscard]] static Result<std::optional<TipArea>> load(const Calibration& calibration);

  // After field.run(); axis of the tool out of the fingertip, 1e-6.
  TipAreas run(const TipField& field, const TipField::Vector& axis_1e6, int64_t force_un, int64_t way_um);

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
  int64_t tip_ = 0;                     // radius of the pins' tips
  std::array<Axis, kInputs> axis_{};
  std::vector<int32_t> table_;  // [inputs ...][kOutputs]: 1e-3 mm^2, Q16, Q16
  std::vector<int64_t> height_;
  std::vector<size_t> order_;
};

}  // namespace ruffini
