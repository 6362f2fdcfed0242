#include "stages/skin/skin_shape.h"

#include "base/fixed.h"
#include "image/trigonometry.h"
#include "solve/node_sigma.h"

namespace ruffini {
namespace {

// pi in units of 2^-40.
constexpr int64_t kPiQ40 = 3'454'217'652'358;
constexpr int64_t kOneQ30 = int64_t{1} << 30;

struct Turn {
  int64_t cos_q30 = kOneQ30;
  int64_t sin_q30 = 0;
};

// Of the angle length / radius.
Turn turn(int64_t way_um, int64_t radius_um) {
  const int64_t half_round_um = round_shift(kPiQ40 * radius_um, 40);
  return {cos_pi_q30(way_um, half_round_um), cos_pi_q30(2 * way_um - half_round_um, 2 * half_round_um)};
}

SkinPoint on_dome(int64_t x_um, int64_t y_um, int64_t radius_um) {
  const int64_t way_um = floor_sqrt(x_um * x_um + y_um * y_um);
  if (way_um == 0) return {{0, 0, 0}, {0, 0, kOneQ30}};
  const Turn t = turn(way_um, radius_um);
  const auto share = [&](int64_t axis_um) { return floor_div(t.sin_q30 * axis_um, way_um); };
  SkinPoint point{{}, {share(x_um), share(y_um), t.cos_q30}};
  for (size_t c = 0; c < 3; ++c) point.place_um[c] = round_shift(point.out_q30[c] * radius_um, 30);
  point.place_um[2] -= radius_um;
  return point;
}

}  // namespace

SkinPoint on_skin(const SkinSettings& skin, int64_t x_um, int64_t y_um) {
  if (skin.shape == SkinShape::kPlane) return {{x_um, y_um, 0}, {0, 0, kOneQ30}};
  if (skin.shape == SkinShape::kDome) return on_dome(x_um, y_um, skin.radius_um);
  const Turn t = turn(x_um, skin.radius_um);
  return {{round_shift(skin.radius_um * t.cos_q30, 30), round_shift(skin.radius_um * t.sin_q30, 30), y_um},
          {t.cos_q30, t.sin_q30, 0}};
}

std::array<int64_t, 3> pressing_vector_un(const SkinPoint& point, int64_t press_un) {
  std::array<int64_t, 3> force{};
  for (size_t c = 0; c < 3; ++c) force[c] = round_shift(-press_un * point.out_q30[c], 30);
  return force;
}

}  // namespace ruffini
