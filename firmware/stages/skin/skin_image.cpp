#include "stages/skin/skin_image.h"

#include <algorithm>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int64_t kMaxShift = 4;
constexpr int32_t kMaxPlaceUm = 1'000'000;
constexpr int32_t kMaxForceUn = 1'000'000'000;

Error bad(const std::string& what) {
  return {ErrorKind::kBadInput,
          "calibration file: skin." + what + ": make it again with `ruffini cal fit --only skin`"};
}

bool is_within(std::span<const int32_t> values, int32_t limit) {
  return std::all_of(values.begin(), values.end(), [&](int32_t v) { return v >= -limit && v <= limit; });
}

}  // namespace

Result<SkinImage> SkinImage::load(const Calibration& calibration, const BoardSettings& board) {
  const auto shift = calibration.integer("skin.step_log2", 0, kMaxShift);
  if (!shift) return shift.error();
  SkinImage skin;
  skin.camera_ = board.camera;
  skin.mode_ = board.skin.mode;
  skin.round_um_ = board.skin.shape == SkinShape::kTube ? board.pad.size_x_um : 0;
  skin.threshold_un_ = board.contact.threshold_un;
  skin.shift_ = static_cast<int>(shift.value());
  const auto lines = [&](int n_px) { return ((n_px - 2) >> skin.shift_) + 2; };
  skin.lattice_ = {lines(board.camera.width_px), lines(board.camera.height_px)};
  const auto place = calibration.tensor("skin.place", Tensor::Type::kI32, {skin.lattice_.n_y, skin.lattice_.n_x, 2});
  if (!place) return place.error();
  const auto curve = calibration.tensor("skin.curve", Tensor::Type::kI32, {kCurveSize});
  if (!curve) return curve.error();
  const auto places = place.value()->as<int32_t>();
  const auto forces = curve.value()->as<int32_t>();
  if (!is_within(places, kMaxPlaceUm)) return bad("place leads beyond 1 m of skin");
  if (!is_within(forces, kMaxForceUn)) return bad("curve goes beyond 1000 N");
  skin.place_um_.assign(places.begin(), places.end());
  skin.curve_un_.assign(forces.begin(), forces.end());
  return skin;
}

int64_t SkinImage::force_un(int64_t brightness_q2) const {
  const int64_t at = std::clamp<int64_t>(brightness_q2, 0, int64_t{kCurveStep} * (kCurveSize - 1));
  const auto i = static_cast<size_t>(std::min<int64_t>(at / kCurveStep, kCurveSize - 2));
  const int64_t part = at - int64_t{kCurveStep} * static_cast<int64_t>(i);
  return floor_div(curve_un_[i] * (kCurveStep - part) + curve_un_[i + 1] * part + kCurveStep / 2, kCurveStep);
}

SkinTouch SkinImage::touch(int64_t px_x_q16, int64_t px_y_q16, int64_t brightness_q2) const {
  const int64_t u = std::clamp<int64_t>(px_x_q16, 0, int64_t{camera_.width_px - 1} << 16) >> shift_;
  const int64_t v = std::clamp<int64_t>(px_y_q16, 0, int64_t{camera_.height_px - 1} << 16) >> shift_;
  const int64_t column = std::min<int64_t>(u >> 16, lattice_.n_x - 2);
  const int64_t row = std::min<int64_t>(v >> 16, lattice_.n_y - 2);
  const int64_t right = u - (column << 16);
  const int64_t below = v - (row << 16);
  const int32_t* const upper = place_um_.data() + 2 * (row * lattice_.n_x + column);
  const int32_t* const lower = upper + ptrdiff_t{2} * lattice_.n_x;
  const auto read = [&](size_t axis, int64_t round) {
    const int64_t first = upper[axis];
    const auto near = [&](int64_t value) {
      if (round == 0) return value;
      return value - first > round / 2 ? value - round : value - first < -round / 2 ? value + round : value;
    };
    const int64_t top = first * (65'536 - right) + near(upper[axis + 2]) * right;
    const int64_t bottom = near(lower[axis]) * (65'536 - right) + near(lower[axis + 2]) * right;
    const int64_t value = round_shift(top * (65'536 - below) + bottom * below, 32);
    if (round == 0) return value;
    return value > round / 2 ? value - round : value < -round / 2 ? value + round : value;
  };
  return {.x_um = read(0, round_um_),
          .y_um = read(1, 0),
          .brightness_q2 = brightness_q2,
          .press_un = force_un(brightness_q2)};
}

SkinTouchList SkinImage::run(const GlowRegions& seen) const {
  SkinTouchList list;
  const auto add = [&](const SkinTouch& touch) {
    if (touch.press_un < threshold_un_) return;
    ++list.n_found;
    if (list.n_listed < SkinTouchList::kMax) list.touch[static_cast<size_t>(list.n_listed++)] = touch;
  };
  if (mode_ == SkinMode::kSingle || (mode_ == SkinMode::kAuto && seen.n_found() <= 1)) {
    const GlowPeak& peak = seen.peak();
    // In addition to the contact threshold, because the curve may begin above it.
    if (seen.n_found() > 0) add(touch(int64_t{peak.x_px} << 16, int64_t{peak.y_px} << 16, peak.level_q2));
    return list;
  }
  for (const GlowRegion& region : seen.regions()) add(touch(region.x.raw(), region.y.raw(), region.mean_q2));
  return list;
}

}  // namespace ruffini
