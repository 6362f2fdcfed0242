// Covariance of the wrench about the pad's centre: upper triangle by rows, (uN, uN mm)^2.
//
// It is a sum of outer products of whole vectors, so it is positive semi-definite in integers too:
//
//   all contacts together   the shear part of the wrench (fx, fy, tz) times one relative error and its pressure part
//                           (fz, tx, ty) times another: errors of the finite elements and of a slightly wrong
//                           material law
//   the whole wrench        times the relative standard deviation of the pad's stiffness
//                           (stages/support/uncertainty_stage.cpp)
//   each contact, about     sigma of each force component, moved to the pad's centre as the wrench of a force there;
//   its centre of pressure  sigma of each moment: a constant plus a lever times the normal force; of shear: a constant
//                           plus the crosstalk times the normal force
//   filled nodes            kFilledShear_q8, kFilledNormal_q8 times the magnitudes of their forces, each where it acts:
//                           one vector for x, y and z each, as if all of them erred together
//
// Each contact beyond the listed ones counts as one more, anywhere on the pad. Without contact, the error of one
// contact in the middle is reported. Vectors are clamped to +-kMaxSigma, so no sum overflows. Frame thread; no
// allocation. Not in the paper; the model is in host/ruffini/fem/uncertainty.py.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "base/result.h"
#include "core/results.h"
#include "estimators/wrench.h"
#include "store/calibration.h"

namespace ruffini {

// sum += times v v^T. Precondition: no element exceeds 63 bits.
void add_outer(WrenchCovariance& sum, const std::array<int64_t, 6>& v, int64_t times = 1);

// Sums over filled nodes (base/filled.h) of the magnitudes of their forces, uN, and of these times x or y from the
// pad's centre, uN um. Normal forces count where depth is filled too.
struct FilledForce {
  int64_t x_un = 0;
  int64_t y_un = 0;
  int64_t z_un = 0;
  int64_t y_of_x_un_um = 0;  // y times |fx|
  int64_t x_of_y_un_um = 0;
  int64_t y_of_z_un_um = 0;
  int64_t x_of_z_un_um = 0;
};

[[nodiscard]] FilledForce sum_filled(const NodeGrid& grid, std::span<const NodeForce> force,
                                     std::span<const uint8_t> filled, int64_t force_lsb_un);

class WrenchErrorModel {
 public:
  static constexpr int kParameters = 8;
  static constexpr int64_t kMaxSigma = int64_t{1} << 28;  // uN, uN mm: 268 N
  // A hole of 3.3 mm under a contact adds an error of this share of the force on its filled nodes (Q8): 1/8 of shear,
  // 0.086 of pressure. Chosen on the contacts bench.states.FRESH. Several small holes err independently, so their sigma
  // is too large.
  static constexpr int64_t kFilledShear_q8 = 32;
  static constexpr int64_t kFilledNormal_q8 = 22;

  // Loads the tensors support.error_wrench and, if there, support.error_crosstalk. stiffness_q20: relative, at most one
  // half.
  [[nodiscard]] static Result<WrenchErrorModel> load(const Calibration& calibration, const PadSettings& pad,
                                                     int64_t stiffness_q20 = 0);

  [[nodiscard]] WrenchCovariance run(const Wrench& wrench, const ContactList& contacts,
                                     const FilledForce& filled = {}) const;

 private:
  using Vector = std::array<int64_t, 6>;

  // Standard deviations of one contact's own error. Index 0: shear, or an axis in the surface; 1: normal, or z.
  struct ContactError {
    std::array<int64_t, 2> force_un{};
    std::array<int64_t, 2> moment_un_mm{};
    std::array<int64_t, 2> lever_nm{};
  };

  void add_contact(WrenchCovariance& sum, const Contact& contact) const;
  void add_unlisted(WrenchCovariance& sum, int64_t n_contacts) const;

  ContactError contact_;
  std::array<int64_t, 2> factor_q20_{};
  int64_t crosstalk_q20_ = 0;  // shear error over a contact's normal force
  int64_t stiffness_q20_ = 0;
  int64_t half_x_um_ = 0;
  int64_t half_y_um_ = 0;
};

}  // namespace ruffini
