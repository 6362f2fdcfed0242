#include "image/slipped_pins.h"

#include <algorithm>
#include <cstdlib>
#include <limits>

namespace ruffini {
namespace {

constexpr int64_t kLimitQ16 = 13'107;  // 0.2 px: a slip by a pixel may be shared by the markers that it tears
constexpr int kStepPx = 4;
constexpr int kStepBits = 18;
constexpr int64_t kStepQ16 = int64_t{1} << kStepBits;
static_assert(kStepQ16 == int64_t{kStepPx} << 16);
constexpr int kMinPairs = 16;
constexpr int kReachPart = 8;  // of the picture's height

}  // namespace

SlippedPins::SlippedPins(int height_px)
    : reach_q16_((int64_t{height_px} << 16) / kReachPart), lines_(static_cast<size_t>(height_px / kStepPx) + 1) {}

void SlippedPins::learn(std::span<const Marker> markers, size_t n_views) {
  above_.assign(markers.size(), kNone);
  below_.assign(markers.size(), kNone);
  const size_t n_in_view = markers.size() / std::max<size_t>(n_views, 1);
  for (size_t i = 0; i < n_in_view * n_views; ++i) {
    if (markers[i].is_absent) continue;
    std::array<int64_t, 2> nearest{std::numeric_limits<int64_t>::max(), std::numeric_limits<int64_t>::max()};
    const size_t first = i / n_in_view * n_in_view;
    for (size_t j = first; j < first + n_in_view; ++j) {
      const int64_t dx = int64_t{markers[j].rest_x.raw()} - markers[i].rest_x.raw();
      const int64_t dy = int64_t{markers[j].rest_y.raw()} - markers[i].rest_y.raw();
      if (markers[j].is_absent || dy == 0 || std::abs(dx) > std::abs(dy) || std::abs(dy) > reach_q16_) continue;
      const int64_t square = dx * dx + dy * dy;
      const size_t side = dy > 0 ? 1 : 0;
      if (square >= nearest[side] || square > reach_q16_ * reach_q16_) continue;
      nearest[side] = square;
      (side == 1 ? below_ : above_)[i] = static_cast<int>(j);
    }
  }
}

bool SlippedPins::run(std::span<const Marker> markers) {
  // A bend is less than four times the largest displacement.
  const auto is_small = [](ImagePx d) { return std::abs(int64_t{d.raw()}) <= kLimitQ16 / 4; };
  if (std::all_of(markers.begin(), markers.end(), [&](const Marker& m) {
        return m.is_lost || m.is_absent || (is_small(m.displacement_x) && is_small(m.displacement_y));
      })) {
    return false;
  }
  std::fill(lines_.begin(), lines_.end(), Line{});
  const auto is_known = [&](int i) {
    return i != kNone && !markers[static_cast<size_t>(i)].is_lost && !markers[static_cast<size_t>(i)].is_absent;
  };
  using Jump = std::array<int64_t, 2>;  // along x, y
  const auto jump = [&](int from, int to) -> Jump {
    const Marker& a = markers[static_cast<size_t>(from)];
    const Marker& b = markers[static_cast<size_t>(to)];
    return {int64_t{b.displacement_x.raw()} - a.displacement_x.raw(),
            int64_t{b.displacement_y.raw()} - a.displacement_y.raw()};
  };
  const auto y_of = [&](int i) {
    const Marker& m = markers[static_cast<size_t>(i)];
    return int64_t{m.rest_y.raw()} + m.displacement_y.raw();
  };
  for (int i = 0; i < static_cast<int>(below_.size()); ++i) {
    const int j = below_[static_cast<size_t>(i)];
    if (!is_known(i) || !is_known(j)) continue;
    const int before = above_[static_cast<size_t>(i)];
    const int after = below_[static_cast<size_t>(j)];
    int64_t n_beside = 0;
    Jump beside{};  // times n_beside
    const auto add = [&](const Jump& other) {
      beside = {beside[0] + other[0], beside[1] + other[1]};
      ++n_beside;
    };
    if (is_known(before)) add(jump(before, i));
    if (is_known(after)) add(jump(j, after));
    if (n_beside == 0) continue;
    const int64_t first = std::max<int64_t>((y_of(i) + kStepQ16 - 1) >> kStepBits, 0);
    const int64_t last = std::min<int64_t>(y_of(j) >> kStepBits, std::ssize(lines_) - 2);
    if (first > last) continue;
    Line& begin = lines_[static_cast<size_t>(first)];
    Line& end = lines_[static_cast<size_t>(last) + 1];
    ++begin.n;
    --end.n;
    const Jump here = jump(i, j);
    for (size_t axis = 0; axis < here.size(); ++axis) {
      const int64_t bend = n_beside * here[axis] - beside[axis];
      if (std::abs(bend) <= n_beside * kLimitQ16) continue;
      const auto side = bend > 0 ? &Line::n_more : &Line::n_less;
      ++(begin.*side)[axis];
      --(end.*side)[axis];
    }
  }
  Line line;
  return std::any_of(lines_.begin(), lines_.end(), [&](const Line& change) {
    line.n += change.n;
    for (size_t axis = 0; axis < 2; ++axis) {
      line.n_more[axis] += change.n_more[axis];
      line.n_less[axis] += change.n_less[axis];
    }
    const int most = std::max({line.n_more[0], line.n_more[1], line.n_less[0], line.n_less[1]});
    return line.n >= kMinPairs && 2 * most >= line.n;
  });
}

}  // namespace ruffini
