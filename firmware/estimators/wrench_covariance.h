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
//   its centre of pressure  sigma of each moment: a constant plus a lever times the normal force. Shear sigmas are
//                           multiplied by sqrt(1 + kFilledShear share), share: filled fraction of the touched nodes;
//                           normal ones by sqrt(1 + kFilledNormal share) of those with filled depth
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

// Number of nodes in the contact mask, and how many of them are filled, how many with their depth (base/filled.h).
struct TouchedNodes {
  int64_t n = 0;
  int64_t n_filled = 0;
  int64_t n_all_filled = 0;
};

[[nodiscard]] TouchedNodes count_touched(std::span<const uint8_t> mask, std::span<const uint8_t> filled);

class WrenchErrorModel {
 public:
  static constexpr int kParameters = 8;
  static constexpr int64_t kMaxSigma = int64_t{1} << 28;  // uN, uN mm: 268 N
  // Twice the sigma at a share s of independent nodes makes the variance 1 + 3 s times as large, but one lost marker
  // affects several nodes. A factor of 6 makes sigma 1.14, 1.26 and 1.48 times as large at shares of 5, 10 and 20 %,
  // where the error of the resultant was 1.07, 1.11 and 1.57 times as large (host/ruffini/fem/DESIGN.md, "Lost
  // markers").
  static constexpr int64_t kFilledShear = 6;
  // A hole of 3.3 mm under 20 to 40 % of the touched nodes (development contacts) makes the errors of fz, tx
  // and ty 1.1 to 1.7 times as large; a factor of 6 makes sigma 1.5 to 1.8 times as large.
  static constexpr int64_t kFilledNormal = 6;

  // Loads the tensor support.error_wrench. stiffness_q20: relative, at most one half.
  [[nodiscard]] static Result<WrenchErrorModel> load(const Calibration& calibration, const PadSettings& pad,
                                                     int64_t stiffness_q20 = 0);

  [[nodiscard]] WrenchCovariance run(const Wrench& wrench, const ContactList& contacts,
                                     const TouchedNodes& touched = {}) const;

 private:
  using Vector = std::array<int64_t, 6>;

  // Standard deviations of one contact's own error. Index 0: shear, or an axis in the surface; 1: normal, or z.
  struct ContactError {
    std::array<int64_t, 2> force_un{};
    std::array<int64_t, 2> moment_un_mm{};
    std::array<int64_t, 2> lever_nm{};
  };

  static void add_contact(WrenchCovariance& sum, const ContactError& error, const Contact& contact);
  void add_unlisted(WrenchCovariance& sum, const ContactError& error, int64_t n_contacts) const;
  [[nodiscard]] ContactError scaled_for_filled(const TouchedNodes& touched) const;

  ContactError contact_;
  std::array<int64_t, 2> factor_q20_{};
  int64_t stiffness_q20_ = 0;
  int64_t half_x_um_ = 0;
  int64_t half_y_um_ = 0;
};

}  // namespace ruffini
