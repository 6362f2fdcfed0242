#include "stages/fingertip/rim_motion.h"

#include <algorithm>

#include "base/fixed.h"
#include "estimators/common_part.h"

namespace ruffini {
namespace {

constexpr size_t kPart = 5;        // of the pins
constexpr int64_t kShift = 7'864;  // 0.12 px
constexpr int64_t kZoom = 3'932;   // 0.06 px
constexpr int kPlaceShift = 8;     // of squares: Q8 px

enum Sector : size_t { kRight, kLeft, kBelow, kAbove };

}  // namespace

void RimMotion::learn(std::span<const Marker> markers) {
  struct Place {
    size_t number = 0;
    int64_t x = 0;  // Q16 px, relative to the centre
    int64_t y = 0;
    int64_t square = 0;
  };
  std::vector<Place> places;
  for (size_t i = 0; i < markers.size(); ++i) {
    if (!markers[i].is_absent) places.push_back({i, markers[i].rest_x.raw(), markers[i].rest_y.raw(), 0});
  }
  for (std::vector<size_t>& sector : rim_) sector.clear();
  if (places.empty()) return;
  const auto [left, right] =
      std::minmax_element(places.begin(), places.end(), [](const Place& a, const Place& b) { return a.x < b.x; });
  const auto [top, bottom] =
      std::minmax_element(places.begin(), places.end(), [](const Place& a, const Place& b) { return a.y < b.y; });
  const int64_t middle_x = (left->x + right->x) >> 1;
  const int64_t middle_y = (top->y + bottom->y) >> 1;
  for (Place& p : places) {
    p.x -= middle_x;
    p.y -= middle_y;
    const int64_t x = p.x >> kPlaceShift;
    const int64_t y = p.y >> kPlaceShift;
    p.square = x * x + y * y;
  }
  std::sort(places.begin(), places.end(), [](const Place& a, const Place& b) {
    return a.square != b.square ? a.square > b.square : a.number < b.number;
  });
  places.resize(places.size() / kPart);
  for (const Place& p : places) {
    const bool is_beside = std::max(p.x, -p.x) >= std::max(p.y, -p.y);
    rim_[is_beside ? (p.x > 0 ? kRight : kLeft) : (p.y > 0 ? kBelow : kAbove)].push_back(p.number);
  }
}

RimMotion::Motion RimMotion::motion(std::span<const Marker> markers) const {
  std::array<int64_t, kSectors> x{};
  std::array<int64_t, kSectors> y{};
  for (size_t s = 0; s < kSectors; ++s) {
    int64_t n = 0;
    for (const size_t i : rim_[s]) {
      if (markers[i].is_lost) continue;
      x[s] += markers[i].displacement_x.raw();
      y[s] += markers[i].displacement_y.raw();
      ++n;
    }
    const bool is_seen = n > 0 && 2 * n >= std::ssize(rim_[s]);
    x[s] = is_seen ? floor_div(x[s], n) : 0;
    y[s] = is_seen ? floor_div(y[s], n) : 0;
  }
  return {.shift_x_q16 = common_part(x),
          .shift_y_q16 = common_part(y),
          .zoom_q16 = common_part({x[kRight], -x[kLeft], y[kBelow], -y[kAbove]}),
          .turn_q16 = common_part({y[kRight], -y[kLeft], -x[kBelow], x[kAbove]})};
}

bool RimMotion::has_moved(std::span<const Marker> markers, int64_t force_un, int64_t max_un) const {
  const Motion seen = motion(markers);
  const int64_t load_q16 = (std::clamp<int64_t>(force_un, 0, max_un) << 16) / max_un;
  const int64_t shift = kShift + (at_max_.shift_q16 * load_q16 >> 16);
  const int64_t zoom = kZoom + (at_max_.zoom_q16 * load_q16 >> 16);
  return std::max(seen.shift_x_q16, seen.shift_y_q16) > shift || std::max(seen.zoom_q16, seen.turn_q16) > zoom;
}

}  // namespace ruffini
