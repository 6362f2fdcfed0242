// Covariance of the wrench about the pad's centre: upper triangle by rows, (uN, uN mm)^2.
//
// A sum of outer products of whole vectors, so it is positive semi-definite in integers too:
//
//   all contacts together   the shear part of the wrench (fx, fy, tz) times a common factor, and its
//                           pressure part (fz, tx, ty) times another: what the
//                           finite elements and a slightly wrong shape of the material make of it
//   the whole wrench        times the relative standard deviation of the pad's stiffness (stages/support/uncertainty_stage.cpp)
//   each contact, about     sigma of each force component, carried to the pad's centre as the wrench of a force
//   its centre of pressure  there; sigma of each moment: a constant and a lever times the pressing force. Those of the
//                           shear part times sqrt(1 + kFilledShear share), share of the touched nodes that are filled
//
// Contacts beyond the listed ones count like one each, anywhere on the pad; where nothing touches, the
// error of one contact in the middle stands. Vectors are held to +-kMaxSigma, so no sum overflows.
// Frame thread; no allocation. Not in the paper; host/ruffini/fem/uncertainty.py has the model.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "base/result.h"
#include "core/results.h"
#include "estimators/wrench.h"
#include "store/calibration.h"

namespace ruffini {

// sum += times v v^T. Precondition: nothing leaves 63 bits.
void add_outer(WrenchCovariance& sum, const std::array<int64_t, 6>& v, int64_t times = 1);

// Nodes of the contact mask, and which of them are filled (image/displacement.h).
struct TouchedNodes {
  int64_t n = 0;
  int64_t n_filled = 0;
};

[[nodiscard]] TouchedNodes count_touched(std::span<const uint8_t> mask, std::span<const uint8_t> is_filled);

class WrenchErrorModel {
 public:
  static constexpr int kParameters = 8;
  static constexpr int64_t kMaxSigma = int64_t{1} << 28;  // uN, uN mm: 268 N
  // Twice the sigma of a share s of independent nodes would make 1 + 3 s; but a lost marker takes several nodes along. 6
  // makes sigma 1.14, 1.26 and 1.48 times as large at shares of 5, 10 and 20 %, where the resultant's error was 1.07, 1.11
  // and 1.57 times as large (host/ruffini/fem/README.md, "Lost markers").
  static constexpr int64_t kFilledShear = 6;

  // Tensor support.error_wrench. stiffness_q20: relative, at most a half.
  [[nodiscard]] static Result<WrenchErrorModel> load(const Calibration& calibration, const PadSettings& pad,
                                                     int64_t stiffness_q20 = 0);

  [[nodiscard]] WrenchCovariance run(const Wrench& wrench, const ContactList& contacts,
                                     const TouchedNodes& touched = {}) const;

 private:
  using Vector = std::array<int64_t, 6>;

  // Sigmas of one contact's own error. Shear and normal; about an axis in the surface, and about z.
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
