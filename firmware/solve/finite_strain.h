// Finite strain to second order: the part of a soft pad's force that the linear operator lacks.
//
// A neo-Hookean pad holds the surface displacement U with f = K U + Q(U, U) + ... The principle of virtual work gives,
// with E U the displacement inside the linear pad, H = grad(E U) and p = -lambda tr H,
//
//   Q . V = int (-mu (H^T)^2 + p H^T) : grad(E V) + tr(H^2) / 2 p(E V)
//
// E and p are tables over waves along the surface (derivation: host/ruffini/fem/finite_strain.py). Products are taken
// at the centres of three layers of elements. All quantities after the amplitude are relative to U = u 2^amplitude,
// chosen so that the largest entry has 13 bits if u has fewer:
//
//   planes E U     1/16 displacement step, clamped to +-2^22, counted
//   p / mu         Q12, clamped to +-8, counted;     H   Q13, clamped to +-2, counted
//   stress         Q26 in 32 bits: 2 2^15 2^14 + 3 2^28 < 2^31, then Q15 times an area of 10 bits, Q-5: below 2^26
//   sums of waves  Q12 in 64 bits, each part clamped to +-2^58, counted
//
// Kind `finite_strain` of the calibration. Not in the papers. Frame thread; no allocation after load().
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "solve/contact_mask.h"
#include "solve/wave_transform.h"
#include "store/calibration.h"

namespace ruffini {

class FiniteStrain {
 public:
  // Returns kBadInput if the tables are for other nodes, or if the sums could overflow.
  [[nodiscard]] static Result<FiniteStrain> load(const Calibration& calibration, GridSize nodes);

  // Returns Q(U, U) of the displacement `u` (xyz interleaved) as force steps at the nodes, to be added to the linear
  // estimate. Valid until the next call.
  std::span<const NodeForce> run(std::span<const int16_t> u, SaturationCounter& saturations);

 private:
  struct Layer {
    std::array<int32_t, 3> slope{};  // factor from the sum of four differences along x, y, z to H, Q15
    std::array<int32_t, 3> limit{};  // clamp of that sum
    std::array<int32_t, 3> area{};   // area of the element's faces normal to x, y, z, divided by 4
    int32_t volume = 0;
    std::span<const int16_t> extension;  // 3 x 3 x waves
    std::span<const int16_t> pressure;   // 3 x waves
  };
  struct Waves {
    WaveTable cos_x, sin_x, mid_x, cos_y, sin_y, mid_y;
  };

  FiniteStrain(GridSize nodes, std::unique_ptr<const Waves> waves);
  [[nodiscard]] Status load_layers(const Calibration& calibration);
  void find_planes(int exponent, SaturationCounter& saturations);
  void find_pressure(const Layer& layer, int exponent, SaturationCounter& saturations);
  void deform(size_t k, SaturationCounter& saturations);
  void gather_planes(SaturationCounter& saturations);
  void gather_volume(const Layer& layer, SaturationCounter& saturations);
  void finish(int amplitude, SaturationCounter& saturations);

  GridSize nodes_;
  std::unique_ptr<const Waves> tables_;  // heap-allocated, so that its address is stable
  WaveTransform at_nodes_;
  WaveTransform at_middles_;
  std::vector<Layer> layers_;
  int extension_shift_ = 0;
  int pressure_shift_ = 0;
  int volume_shift_ = 0;
  int64_t gain_ = 0;
  int gain_shift_ = 0;

  std::vector<int16_t> wave_;      // of U, three components
  std::vector<int16_t> part_;      // of one plane or layer
  std::vector<int32_t> sums_;      // before narrowing to part_
  std::vector<int32_t> field_;     // at the nodes, three components
  std::vector<int32_t> planes_;    // E U, plane by plane; the last plane is bonded and zero
  std::vector<int32_t> load_;      // nodal forces, in the layout of planes_
  std::vector<int32_t> pressure_;  // p / mu at the element centres
  std::vector<int32_t> square_;    // tr H^2 times volume, at the element centres
  std::vector<int64_t> total_;     // waves of Q
  std::vector<NodeForce> force_;
};

}  // namespace ruffini
