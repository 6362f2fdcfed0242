// Helmholtz decomposition of a texture's flow on the lattice of its patches: u = grad phi + r.
//
//   f      div u times two steps along x: central differences, one-sided and doubled at the border
//   phi    Laplace phi = f with zero slope across the border: cosine transform along x and y, each wave divided by
//          2 (sin^2 tx + rho^2 sin^2 ty), the eigenvalue of two successive central differences; t = pi k / n,
//          rho = step x / step y; then back. The mean of f has no such phi and stays in r
//   grad   central differences of phi, mirrored at the border: the curl-free part
//   r      u - grad phi: divergence-free inside, including the harmonic part (a common shift, a uniform dilation)
//
//   S_n    mean magnitude of grad phi                                    the paper's three quantities: section III-C
//   S_t    magnitude of the mean of r
//   twist  half the mean curl of u (equal to that of r) within two steps of the contact's centre: rotation of the
//          object about z, if the gel sticks to it and the contact is wider than that
//
// Integers: u in 1/16 um, clamped to +-16 mm and counted. Before each pair of transforms all values get a common power
// of two, so that n_x n_y max|f| stays below 2^29 (cosine_transform.h). Lattices of up to 64 x 64 with rho 1/4 to 4:
// |f| < 2^23, the factor of a wave in Q28 below 2^34, its product below 2^63. Lost patches are filled from their
// neighbours (image/markers.h). Frame thread; no allocation after the constructor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "base/fixed.h"
#include "board/settings.h"
#include "core/results.h"
#include "image/cosine_transform.h"

namespace ruffini {

class Helmholtz {
 public:
  static constexpr int64_t kMaxOblong = 4;  // limit of rho and of 1 / rho

  explicit Helmholtz(const BoardSettings& board);

  const HelmholtzSums& run(std::span<const FlowPoint> flow, const Profile& profile, SaturationCounter& saturations);
  [[nodiscard]] const HelmholtzSums& sums() const { return sums_; }
  // grad phi at each patch of the last frame.
  [[nodiscard]] std::span<const FlowPoint> curl_free() const { return gradient_; }

 private:
  [[nodiscard]] size_t at(int x, int y) const { return static_cast<size_t>(y * lattice_.n_x + x); }
  void load_clamped(std::span<const FlowPoint> flow, SaturationCounter& saturations);
  void find_divergence();
  // Scales wide_ by 2^shift into plane_. Returns shift.
  [[nodiscard]] int normalize();
  void solve();
  void find_gradient();
  void sum_up();
  [[nodiscard]] int64_t twist_urad(const Profile& profile) const;

  GridSize lattice_;
  int64_t pitch_x_um_;
  int64_t pitch_y_um_;
  int64_t twice_first_x_um_;  // of the first patch, relative to the pad's centre
  int64_t twice_first_y_um_;
  int64_t rho_q14_;
  CosineTables along_x_;
  CosineTables along_y_;
  std::vector<int64_t> factor_q28_;  // [ky][kx]
  std::vector<int64_t> wide_;
  std::vector<int32_t> plane_;
  std::vector<int32_t> line_;  // a column, its transform, and work space
  int scale_ = 0;              // of plane_ after solve(): phi over the step along x, 2^scale_ / 16 um
  std::vector<FlowPoint> u_;
  std::vector<FlowPoint> gradient_;
  HelmholtzSums sums_;
};

}  // namespace ruffini
