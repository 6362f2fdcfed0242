// Covariance of the wrench about the pad's centre: upper triangle by rows, (uN, uN mm)^2.
//
// A sum of outer products of whole vectors, so it is positive semi-definite in integers too:
//
//   all contacts together   the shear part of the wrench (fx, fy, tz) times a common factor, and its
//                           pressure part (fz, tx, ty) times another: the material
//   each contact, about     sigma of each force component, carried to the pad's centre as the wrench of a force
//   its centre of pressure  there; sigma of each moment: a constant and a lever times the pressing force
//
// Contacts beyond the listed ones count like one each, anywhere on the pad; where nothing touches, the
// error of one contact in the middle stands. Vectors are held to +-kMaxSigma, so no sum overflows.
// Frame thread; no allocation. Not in the paper; host/ruffini/fem/uncertainty.py has the model.
#pragma once

#include <array>
#include <cstdint>

#include "base/result.h"
#include "estimators/contacts.h"
#include "estimators/wrench.h"
#include "store/calibration.h"

namespace ruffini {

struct WrenchCovariance {
  static constexpr size_t kSize = 21;
  std::array<int64_t, kSize> upper{};
  bool operator==(const WrenchCovariance&) const = default;
};

class WrenchErrorModel {
 public:
  static constexpr int kParameters = 8;
  static constexpr int64_t kMaxSigma = int64_t{1} << 28;  // uN, uN mm: 268 N

  // Tensor support.error_wrench.
  [[nodiscard]] static Result<WrenchErrorModel> load(const Calibration& calibration, const PadSettings& pad);

  [[nodiscard]] WrenchCovariance run(const Wrench& wrench, const ContactList& contacts) const;

 private:
  using Vector = std::array<int64_t, 6>;

  static void add(WrenchCovariance& sum, const Vector& v, int64_t times = 1);
  void add_contact(WrenchCovariance& sum, int64_t x_um, int64_t y_um, int64_t force_z_un) const;
  void add_unlisted(WrenchCovariance& sum, int64_t n_contacts) const;

  // Shear and normal; about an axis in the surface, and about z.
  std::array<int64_t, 2> force_un_{};
  std::array<int64_t, 2> moment_un_mm_{};
  std::array<int64_t, 2> lever_nm_{};
  std::array<int64_t, 2> factor_q20_{};
  int64_t half_x_um_ = 0;
  int64_t half_y_um_ = 0;
};

}  // namespace ruffini
