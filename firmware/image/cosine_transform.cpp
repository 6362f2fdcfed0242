#include "image/cosine_transform.h"

#include "image/trigonometry.h"

namespace ruffini {

namespace {

CosineTables::OfFive cosines_of_five() {
  const auto c = [](int64_t j) { return cos_pi_q30(j, 20); };
  return {c(2), c(4), c(6), c(8), c(5), 2 * c(5), c(1) + c(9), c(1) - c(9), c(3) + c(7), c(3) - c(7)};
}

}  // namespace

CosineTables::CosineTables(int n) : n_(n), leaf_n_(n), of_five_(cosines_of_five()) {
  for (int m = n; m % 2 == 0; m /= 2) {
    std::vector<Rotation> rotations;
    for (int i = 0; i < m / 2; ++i) {
      const int64_t angle = 2 * i + 1;  // times pi / (4 m)
      const int32_t c = cos_pi_q30(angle, 4 * m);
      const int32_t s = cos_pi_q30(2 * m - angle, 4 * m);
      rotations.push_back({c, s, i % 2 == 0 ? -s : s, i % 2 == 0 ? c : -c});
    }
    rotation_.push_back(std::move(rotations));
    leaf_n_ = m / 2;
  }
  const int p = leaf_n_;
  for (int k = 0; k < p; ++k) {
    for (int i = 0; i < p; ++i) {
      leaf_ii_.push_back(cos_pi_q30(int64_t{k} * (2 * i + 1), 2 * p));
      leaf_iii_.push_back(cos_pi_q30(int64_t{i} * (2 * k + 1), 2 * p));
      leaf_iv_.push_back(cos_pi_q30(int64_t{2 * k + 1} * (2 * i + 1), 4 * p));
    }
  }
}

}  // namespace ruffini
