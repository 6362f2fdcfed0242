#include "stages/feature_wrench/corner_motion.h"

#include <algorithm>
#include <cstdlib>

#include "base/fixed.h"
#include "estimators/common_part.h"

namespace ruffini {
namespace {

enum MotionOf : size_t { kShiftX, kShiftY, kTurn, kZoom };

constexpr int64_t kMinUn = 90'000;
constexpr int64_t kPart = 12;
constexpr int kUnitShift = 6;                     // of turn and zoom: a 64th
constexpr int64_t kMaxUn = int64_t{1} << 36;      // of forces and responses
constexpr int64_t kMaxShift = int64_t{1} << 24;   // 256 px
constexpr int64_t kMaxStrain = int64_t{1} << 20;  // 1
constexpr int64_t kMaxPitch = int64_t{1} << 40;   // of what one marker's place adds to a sum
constexpr int kPixel = 16;                        // fraction bits
constexpr int kStrain = 20;

int64_t within(int64_t value, int64_t most) { return std::clamp(value, -most, most); }

}  // namespace

CornerMotion::Corner CornerMotion::corner(std::span<const Marker> markers, int first_x, int first_y, int side) const {
  Corner out;
  int n_lost = 0;
  int64_t x = 0, y = 0, x_x = 0, x_y = 0, y_x = 0, y_y = 0;  // of u along x, along y; times the place along x, along y
  for (int j = 0; j < side; ++j) {
    for (int i = 0; i < side; ++i) {
      const Marker& m = markers[static_cast<size_t>((first_y + j) * lattice_.n_x + first_x + i)];
      n_lost += m.is_lost ? 1 : 0;
      const int64_t at_x = 2 * i - (side - 1);
      const int64_t at_y = 2 * j - (side - 1);
      x += m.displacement_x.raw();
      y += m.displacement_y.raw();
      x_x += m.displacement_x.raw() * at_x;
      x_y += m.displacement_x.raw() * at_y;
      y_x += m.displacement_y.raw() * at_x;
      y_y += m.displacement_y.raw() * at_y;
    }
  }
  if (4 * n_lost > side * side) return out;
  // sum of (2 i - (n - 1))^2 over n x n places = n^2 (n^2 - 1) / 3
  const int64_t square = int64_t{side} * side * (int64_t{side} * side - 1) / 3;
  const auto slope = [&](int64_t sum, int64_t pitch_q16) {
    return within(floor_div(within(sum, kMaxPitch) << kStrain, square * pitch_q16), kMaxStrain);
  };
  out.value[kShiftX] = within(floor_div(x, int64_t{side} * side), kMaxShift);
  out.value[kShiftY] = within(floor_div(y, int64_t{side} * side), kMaxShift);
  out.value[kTurn] = slope(y_x, pitch_x_q16_) - slope(x_y, pitch_y_q16_);
  out.value[kZoom] = slope(x_x, pitch_x_q16_) + slope(y_y, pitch_y_q16_);
  return out;
}

CornerMotion::Motion CornerMotion::motion(std::span<const Marker> markers) const {
  if (!is_large_enough()) return {};
  std::array<std::array<int64_t, 4>, kMotions> of_corner{};
  for (size_t k = 0; k < 4; ++k) {
    const auto first = [&](bool is_last, int n, int side) { return is_last ? n - side : 0; };
    const auto at = [&](int side) {
      return corner(markers, first(k % 2 != 0, lattice_.n_x, side), first(k / 2 != 0, lattice_.n_y, side), side);
    };
    const Corner small = at(kSide);
    for (size_t m = 0; m < kMotions; ++m) of_corner[m][k] = small.value[m];
    const int64_t zoom = small.value[kZoom];
    const int64_t beyond = zoom + 7 * (zoom - at(kWide).value[kZoom]) / 4;
    of_corner[kZoom][k] = zoom > 0 ? std::clamp<int64_t>(beyond, 0, zoom) : std::clamp<int64_t>(beyond, zoom, 0);
  }
  return {.shift_x_q16 = common_part(of_corner[kShiftX]),
          .shift_y_q16 = common_part(of_corner[kShiftY]),
          .turn_q20 = common_part(of_corner[kTurn]),
          .zoom_q20 = common_part(of_corner[kZoom])};
}

void CornerMotion::learn(std::span<const Marker> markers, const FeatureWrench& wrench) {
  if (!is_large_enough()) return;
  const Marker& first = markers.front();
  const Marker& last = markers.back();
  const auto pitch = [](int64_t from, int64_t to, int n) { return std::max<int64_t>((to - from) / (n - 1), 1); };
  pitch_x_q16_ = pitch(first.rest_x.raw(), last.rest_x.raw(), lattice_.n_x);
  pitch_y_q16_ = pitch(first.rest_y.raw(), last.rest_y.raw(), lattice_.n_y);
  const int64_t middle_x = (int64_t{first.rest_x.raw()} + last.rest_x.raw()) / 2;
  const int64_t middle_y = (int64_t{first.rest_y.raw()} + last.rest_y.raw()) / 2;
  std::vector<int32_t> features(2 * markers.size());
  for (size_t motion = 0; motion < kMotions; ++motion) {
    for (size_t i = 0; i < markers.size(); ++i) {
      const int64_t x = (markers[i].rest_x.raw() - middle_x) >> kUnitShift;
      const int64_t y = (markers[i].rest_y.raw() - middle_y) >> kUnitShift;
      const std::array<std::array<int64_t, 2>, kMotions> shown{{{1 << kPixel, 0}, {0, 1 << kPixel}, {-y, x}, {x, y}}};
      features[2 * i] = static_cast<int32_t>(shown[motion][0]);
      features[2 * i + 1] = static_cast<int32_t>(shown[motion][1]);
    }
    const Wrench answer = wrench.linear_part(features);
    response_un_[motion] = {answer.force_x_un, answer.force_y_un, answer.force_z_un};
    for (int64_t& force : response_un_[motion]) force = std::min(std::abs(force), kMaxUn);
  }
}

bool CornerMotion::has_moved(std::span<const Marker> markers, const Wrench& wrench) const {
  const Motion seen = motion(markers);
  const int64_t smaller = seen.turn_q20 * seen.turn_q20 >> (kStrain + 1);
  const std::array<int64_t, kMotions> size{seen.shift_x_q16, seen.shift_y_q16, seen.turn_q20, seen.zoom_q20 + smaller};
  const auto held = [](int64_t force_un) { return std::min(std::abs(force_un), kMaxUn); };
  const int64_t force_un = held(wrench.force_x_un) + held(wrench.force_y_un) + held(wrench.force_z_un);
  for (size_t axis = 0; axis < kAxes; ++axis) {
    int64_t made_un = 0;
    for (size_t m = 0; m < kMotions; ++m) {
      made_un += response_un_[m][axis] * size[m] >> (m < kTurn ? kPixel : kStrain - kUnitShift);
    }
    if (made_un > kMinUn + force_un / kPart) return true;
  }
  return false;
}

}  // namespace ruffini
