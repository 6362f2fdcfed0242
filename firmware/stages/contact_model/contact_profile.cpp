#include "stages/contact_model/contact_profile.h"

#include <algorithm>

#include "base/fixed.h"
#include "solve/node_sigma.h"

namespace ruffini {
namespace {

constexpr int kAngles = 32;
constexpr int kOpposite = kAngles / 2;
constexpr int kTurnFraction = 14;
constexpr int64_t kOne = int64_t{1} << kTurnFraction;
// cos(2 pi i / 32), Q14; the sine lags by a quarter turn.
constexpr std::array<int64_t, kAngles> kCosine = {
    16384,  16069,  15137,  13623,  11585,  9102,  6270,  3196,  0, -3196, -6270, -9102, -11585, -13623, -15137, -16069,
    -16384, -16069, -15137, -13623, -11585, -9102, -6270, -3196, 0, 3196,  6270,  9102,  11585,  13623,  15137,  16069};

constexpr int64_t cosine(int angle) { return kCosine[static_cast<size_t>(angle % kAngles)]; }
constexpr int64_t sine(int angle) { return cosine(angle + kAngles - kAngles / 4); }

// Catmull-Rom between the second and the third of four values, Q14; t in Q14.
std::array<int64_t, 4> weights(int64_t t) {
  const int64_t t2 = round_shift(t * t, kTurnFraction);
  const int64_t t3 = round_shift(t2 * t, kTurnFraction);
  const int64_t before = round_shift(2 * t2 - t - t3, 1);
  const int64_t here = kOne + round_shift(3 * t3 - 5 * t2, 1);
  const int64_t beyond = round_shift(t3 - t2, 1);
  return {before, here, kOne - before - here - beyond, beyond};
}

}  // namespace

ContactProfile::ContactProfile(const BoardSettings& board)
    : lattice_(board.markers.lattice),
      px_to_um_q20_(floor_div(board.camera.standoff_um * 1'000 << 20, board.camera.focal_mpx << 12)),
      ring_um_(std::min(board.pad.size_x_um, board.pad.size_y_um) / kRingsAcross),
      pitch_{board.markers.pitch_x_um << 4, board.markers.pitch_y_um << 4},
      first_{(2 * board.markers.first_x_um - board.pad.size_x_um) << 3,
             (2 * board.markers.first_y_um - board.pad.size_y_um) << 3},
      last_{first_.x_q4 + (lattice_.n_x - 1) * pitch_.x_q4, first_.y_q4 + (lattice_.n_y - 1) * pitch_.y_q4},
      flow_(static_cast<size_t>(lattice_.count())),
      raw_fall_(flow_.size()),
      fall_(flow_.size()) {}

ContactProfile::Point ContactProfile::place(int x, int y) const {
  return {first_.x_q4 + x * pitch_.x_q4, first_.y_q4 + y * pitch_.y_q4};
}

const ContactProfile::Point& ContactProfile::flow(int x, int y) const {
  const int column = std::clamp(x, 0, lattice_.n_x - 1);
  const int row = std::clamp(y, 0, lattice_.n_y - 1);
  return flow_[static_cast<size_t>(row * lattice_.n_x + column)];
}

void ContactProfile::load_flow(std::span<const Marker> markers) {
  const auto um_q4 = [&](ImagePx px) { return round_shift(px.raw() * px_to_um_q20_, 20); };
  std::transform(markers.begin(), markers.end(), flow_.begin(),
                 [&](const Marker& m) { return Point{um_q4(m.displacement_x), um_q4(m.displacement_y)}; });
}

void ContactProfile::find_fall() {
  const int n_x = lattice_.n_x;
  for (int y = 1; y + 1 < lattice_.n_y; ++y) {
    for (int x = 1; x + 1 < n_x; ++x) {
      const int64_t along_x = floor_div((flow(x + 1, y).x_q4 - flow(x - 1, y).x_q4) << 15, pitch_.x_q4);
      const int64_t along_y = floor_div((flow(x, y + 1).y_q4 - flow(x, y - 1).y_q4) << 15, pitch_.y_q4);
      raw_fall_[static_cast<size_t>(y * n_x + x)] = static_cast<int32_t>(along_x + along_y);
    }
  }
  const auto raw = [&](int x, int y) {
    return int64_t{
        raw_fall_[static_cast<size_t>(std::clamp(y, 0, lattice_.n_y - 1) * n_x + std::clamp(x, 0, n_x - 1))]};
  };
  const auto along_x = [&](int x, int y) { return raw(x - 1, y) + 2 * raw(x, y) + raw(x + 1, y); };
  for (int y = 0; y < lattice_.n_y; ++y) {
    for (int x = 0; x < n_x; ++x) {
      const int64_t sum = along_x(x, y - 1) + 2 * along_x(x, y) + along_x(x, y + 1);
      fall_[static_cast<size_t>(y * n_x + x)] = static_cast<int32_t>(round_shift(sum, 4));
    }
  }
}

ContactProfile::Point ContactProfile::center() const {
  const int64_t least = 3 * profile_.fall_q16 / 10;
  int64_t sum = 0;
  Point moment;
  for (int y = 0; y < lattice_.n_y; ++y) {
    for (int x = 0; x < lattice_.n_x; ++x) {
      const int64_t weight = std::max<int64_t>(fall_[static_cast<size_t>(y * lattice_.n_x + x)] - least, 0);
      const Point at = place(x, y);
      sum += weight;
      moment.x_q4 += weight * at.x_q4;
      moment.y_q4 += weight * at.y_q4;
    }
  }
  if (sum == 0) return {};
  return {floor_div(2 * moment.x_q4 + sum, 2 * sum), floor_div(2 * moment.y_q4 + sum, 2 * sum)};
}

int64_t ContactProfile::mean_flow_q4() const {
  Point sum;
  for (const Point& one : flow_) {
    sum.x_q4 += one.x_q4;
    sum.y_q4 += one.y_q4;
  }
  const auto n = static_cast<int64_t>(flow_.size());
  return floor_sqrt(sum.x_q4 * sum.x_q4 + sum.y_q4 * sum.y_q4) / n;
}

bool ContactProfile::is_inside(const Point& at) const {
  return at.x_q4 >= first_.x_q4 && at.x_q4 <= last_.x_q4 && at.y_q4 >= first_.y_q4 && at.y_q4 <= last_.y_q4;
}

ContactProfile::Point ContactProfile::flow_at(const Point& at) const {
  const int64_t x_q14 = floor_div((at.x_q4 - first_.x_q4) * kOne, pitch_.x_q4);
  const int64_t y_q14 = floor_div((at.y_q4 - first_.y_q4) * kOne, pitch_.y_q4);
  const int column = std::min(static_cast<int>(x_q14 >> kTurnFraction), lattice_.n_x - 2);
  const int row = std::min(static_cast<int>(y_q14 >> kTurnFraction), lattice_.n_y - 2);
  const auto across = weights(x_q14 - column * kOne);
  const auto down = weights(y_q14 - row * kOne);
  Point sum;
  for (int j = 0; j < 4; ++j) {
    Point line;
    for (int i = 0; i < 4; ++i) {
      const Point& one = flow(column + i - 1, row + j - 1);
      line.x_q4 += across[static_cast<size_t>(i)] * one.x_q4;
      line.y_q4 += across[static_cast<size_t>(i)] * one.y_q4;
    }
    sum.x_q4 += down[static_cast<size_t>(j)] * line.x_q4;
    sum.y_q4 += down[static_cast<size_t>(j)] * line.y_q4;
  }
  return {round_shift(sum.x_q4, 2 * kTurnFraction), round_shift(sum.y_q4, 2 * kTurnFraction)};
}

int64_t ContactProfile::radial_q4(const Point& middle, size_t ring) const {
  const int64_t radius_q4 = (static_cast<int64_t>(ring) + 1) * ring_um_ << 4;
  int64_t sum = 0;
  int64_t n = 0;
  for (int angle = 0; angle < kOpposite; ++angle) {
    const int64_t dx = round_shift(radius_q4 * cosine(angle), kTurnFraction);
    const int64_t dy = round_shift(radius_q4 * sine(angle), kTurnFraction);
    const Point here{middle.x_q4 + dx, middle.y_q4 + dy};
    const Point opposite{middle.x_q4 - dx, middle.y_q4 - dy};
    if (!is_inside(here) || !is_inside(opposite)) continue;
    const Point a = flow_at(here);
    const Point b = flow_at(opposite);
    sum += (a.x_q4 - b.x_q4) * cosine(angle) + (a.y_q4 - b.y_q4) * sine(angle);
    n += 2;
  }
  return n == 0 ? 0 : floor_div(2 * sum + n * kOne, 2 * n * kOne);
}

int64_t ContactProfile::lost_1e3(std::span<const Marker> markers, const Point& middle) const {
  const int64_t reach = static_cast<int64_t>(Profile::kRings) * ring_um_ << 4;
  int64_t n = 0;
  int64_t n_lost = 0;
  for (int y = 0; y < lattice_.n_y; ++y) {
    for (int x = 0; x < lattice_.n_x; ++x) {
      const Point at = place(x, y);
      const int64_t dx = at.x_q4 - middle.x_q4;
      const int64_t dy = at.y_q4 - middle.y_q4;
      if (dx * dx + dy * dy > reach * reach) continue;
      ++n;
      n_lost += markers[static_cast<size_t>(y * lattice_.n_x + x)].is_lost ? 1 : 0;
    }
  }
  return n == 0 ? 1'000 : 1'000 * n_lost / n;
}

const Profile& ContactProfile::run(std::span<const Marker> markers) {
  load_flow(markers);
  find_fall();
  profile_.fall_q16 = std::max<int64_t>(*std::max_element(fall_.begin(), fall_.end()), 0);
  const Point middle = center();
  profile_.center_x_um = round_shift(middle.x_q4, 4);
  profile_.center_y_um = round_shift(middle.y_q4, 4);
  int64_t square = 0;
  for (size_t ring = 0; ring < Profile::kRings; ++ring) {
    profile_.radial_q4[ring] = radial_q4(middle, ring);
    square += profile_.radial_q4[ring] * profile_.radial_q4[ring];
  }
  profile_.size_q4 = floor_sqrt(square);
  profile_.lost_1e3 = lost_1e3(markers, middle);
  profile_.flow_q4 = mean_flow_q4();
  return profile_;
}

}  // namespace ruffini
