#include "image/markers.h"

#include <algorithm>

namespace ruffini {
namespace {

int64_t px_q16(int64_t mpx) { return floor_div(mpx * 65536 + 500, 1000); }

// Pixels, Q16, of a length in the undeformed surface.
int64_t length_q16(const CameraSettings& camera, int64_t um) {
  return floor_div(um * camera.focal_mpx * 65536, camera.standoff_um * 1000);
}

}  // namespace

DotParameters dot_parameters(const BoardSettings& board) {
  const MarkerSettings& m = board.markers;
  const int64_t pitch = length_q16(board.camera, std::min(m.pitch_x_um, m.pitch_y_um));
  const int64_t diameter = length_q16(board.camera, m.diameter_um);
  // Area of the disc, px: pi / 4 d^2, with pi / 4 = 201 / 256.
  const int64_t area = ((diameter * diameter >> 16) * 201 / 256) >> 16;
  return {.width_px = board.camera.width_px,
          .height_px = board.camera.height_px,
          .box_radius_px = static_cast<int>(std::max<int64_t>(pitch * 6 / 10 >> 16, 2)),
          .threshold_1e3 = static_cast<int>(m.threshold_1e3),
          .polarity = m.polarity,
          .min_area_px = static_cast<int>(std::max<int64_t>(area / 4, 4)),
          .max_area_px = static_cast<int>(std::max<int64_t>(area * 3, 16))};
}

MarkerLattice::MarkerLattice(const BoardSettings& board) : size_(board.markers.lattice), settings_(board.markers) {
  const CameraSettings& camera = board.camera;
  const int64_t pitch = length_q16(camera, std::min(settings_.pitch_x_um, settings_.pitch_y_um));
  const auto squared_share = [pitch](int64_t percent) { return (pitch * percent / 100) * (pitch * percent / 100); };
  gate2_ = squared_share(45);
  seed_gate2_ = squared_share(60);  // 0.4 pitch along both axes
  step_gate2_ = squared_share(35);
  um_to_px_q32_ = floor_div(camera.focal_mpx * (int64_t{1} << 32), camera.standoff_um * 1000);
  corner_ = {px_q16(camera.center_x_mpx) - (board.pad.size_x_um * um_to_px_q32_ >> 17),
             px_q16(camera.center_y_mpx) - (board.pad.size_y_um * um_to_px_q32_ >> 17)};
  const auto n = static_cast<size_t>(size_.count());
  markers_.resize(n);
  expected_.resize(n);
  dot_of_marker_.resize(n);
  is_open_.resize(n);
  queue_.resize(n);
  known_.resize(n);
  known_next_.resize(n);
  marker_of_dot_.resize(DotDetector::kMaxDots);
  is_dot_taken_.resize(DotDetector::kMaxDots);
}

MarkerLattice::Point MarkerLattice::nominal(int index) const {
  const int64_t x_um = settings_.first_x_um + (index % size_.n_x) * settings_.pitch_x_um;
  const int64_t y_um = settings_.first_y_um + (index / size_.n_x) * settings_.pitch_y_um;
  return {corner_.x + (x_um * um_to_px_q32_ >> 16), corner_.y + (y_um * um_to_px_q32_ >> 16)};
}

// Mutual nearest neighbours within the gate, among open markers and dots not taken.
void MarkerLattice::match(std::span<const Dot> dots, std::span<const Point> expected) {
  const int n_dots = static_cast<int>(dots.size());
  std::fill(dot_of_marker_.begin(), dot_of_marker_.end(), Nearest{-1, gate2_});
  std::fill_n(marker_of_dot_.begin(), n_dots, Nearest{-1, gate2_});
  for (int i = 0; i < size_.count(); ++i) {
    if (is_open_[static_cast<size_t>(i)] == 0) continue;
    const Point& place = expected[static_cast<size_t>(i)];
    Nearest& mine = dot_of_marker_[static_cast<size_t>(i)];
    for (int j = 0; j < n_dots; ++j) {
      const int64_t dx = dots[static_cast<size_t>(j)].x.raw() - place.x;
      const int64_t dy = dots[static_cast<size_t>(j)].y.raw() - place.y;
      const int64_t distance2 = dx * dx + dy * dy;
      if (is_dot_taken_[static_cast<size_t>(j)] != 0) continue;
      if (distance2 < mine.distance2) mine = {j, distance2};
      Nearest& theirs = marker_of_dot_[static_cast<size_t>(j)];
      if (distance2 < theirs.distance2) theirs = {i, distance2};
    }
  }
  for (int i = 0; i < size_.count(); ++i) {
    Nearest& mine = dot_of_marker_[static_cast<size_t>(i)];
    if (mine.index >= 0 && marker_of_dot_[static_cast<size_t>(mine.index)].index != i) mine.index = -1;
  }
}

// The nearest free dot closer than sqrt(limit2) to `place`; -1 = none.
int MarkerLattice::nearest_free(std::span<const Dot> dots, const Point& place, int64_t limit2) const {
  int best = -1;
  for (size_t j = 0; j < dots.size(); ++j) {
    const int64_t dx = dots[j].x.raw() - place.x;
    const int64_t dy = dots[j].y.raw() - place.y;
    const int64_t distance2 = dx * dx + dy * dy;
    if (is_dot_taken_[j] != 0 || distance2 >= limit2) continue;
    best = static_cast<int>(j);
    limit2 = distance2;
  }
  return best;
}

// Assigns dots outwards from `seed`: each neighbour is looked for one nominal step from a marker that
// has its dot. Number of markers found.
int MarkerLattice::grow(std::span<const Dot> dots, int seed) {
  std::fill(dot_of_marker_.begin(), dot_of_marker_.end(), Nearest{-1, 0});
  std::fill(is_dot_taken_.begin(), is_dot_taken_.end(), uint8_t{0});
  int n_found = 0;
  const auto assign = [&](int marker, int dot) {
    if (dot < 0) return;
    dot_of_marker_[static_cast<size_t>(marker)].index = dot;
    is_dot_taken_[static_cast<size_t>(dot)] = 1;
    queue_[static_cast<size_t>(n_found++)] = marker;
  };
  assign(seed, nearest_free(dots, nominal(seed), seed_gate2_));
  for (int next = 0; next < n_found; ++next) {
    const int at = queue_[static_cast<size_t>(next)];
    const Dot& dot = dots[static_cast<size_t>(dot_of_marker_[static_cast<size_t>(at)].index)];
    const Point from = nominal(at);
    const auto look = [&](int neighbour) {
      if (dot_of_marker_[static_cast<size_t>(neighbour)].index >= 0) return;
      const Point to = nominal(neighbour);
      assign(neighbour, nearest_free(dots, {dot.x.raw() + to.x - from.x, dot.y.raw() + to.y - from.y}, step_gate2_));
    };
    const int x = at % size_.n_x;
    const int y = at / size_.n_x;
    if (x > 0) look(at - 1);
    if (x + 1 < size_.n_x) look(at + 1);
    if (y > 0) look(at - size_.n_x);
    if (y + 1 < size_.n_y) look(at + size_.n_x);
  }
  return n_found;
}

int MarkerLattice::learn(std::span<const Dot> dots) {
  // The seed decides which dot is which; one of the middle markers may have no dot, or dust for one.
  const int middle = (size_.n_y / 2) * size_.n_x + size_.n_x / 2;
  int best_seed = middle;
  int best_found = 0;
  for (const int seed : {middle, middle - 1, middle - size_.n_x, middle - size_.n_x - 1}) {
    const int n_found = grow(dots, seed);
    if (n_found > best_found) {
      best_found = n_found;
      best_seed = seed;
    }
  }
  grow(dots, best_seed);
  Point shift{0, 0};  // mean over the markers found, for the places of the absent ones
  for (int n = 0; n < best_found; ++n) {
    const int i = queue_[static_cast<size_t>(n)];
    const Dot& dot = dots[static_cast<size_t>(dot_of_marker_[static_cast<size_t>(i)].index)];
    shift.x += dot.x.raw() - nominal(i).x;
    shift.y += dot.y.raw() - nominal(i).y;
  }
  if (best_found > 0) shift = {floor_div(shift.x, best_found), floor_div(shift.y, best_found)};
  for (int i = 0; i < size_.count(); ++i) {
    const int j = dot_of_marker_[static_cast<size_t>(i)].index;
    const Point place = nominal(i);
    Marker& marker = markers_[static_cast<size_t>(i)];
    marker = Marker{};
    marker.is_absent = marker.is_lost = j < 0;
    marker.rest_x = j < 0 ? ImagePx::from_raw(static_cast<int32_t>(place.x + shift.x)) : dots[static_cast<size_t>(j)].x;
    marker.rest_y = j < 0 ? ImagePx::from_raw(static_cast<int32_t>(place.y + shift.y)) : dots[static_cast<size_t>(j)].y;
  }
  return best_found;
}

int MarkerLattice::neighbour_mean(int index, Point& mean) const {
  const int x = index % size_.n_x;
  const int y = index / size_.n_x;
  int count = 0;
  mean = {0, 0};
  for (int v = std::max(y - 1, 0); v <= std::min(y + 1, size_.n_y - 1); ++v) {
    for (int u = std::max(x - 1, 0); u <= std::min(x + 1, size_.n_x - 1); ++u) {
      const auto at = static_cast<size_t>(v * size_.n_x + u);
      if (known_[at] == 0) continue;
      ++count;
      mean.x += markers_[at].displacement_x.raw();
      mean.y += markers_[at].displacement_y.raw();
    }
  }
  if (count > 0) mean = {floor_div(mean.x, count), floor_div(mean.y, count)};
  return count;
}

void MarkerLattice::expect_with_neighbours() {
  for (int i = 0; i < size_.count(); ++i) {
    const Marker& marker = markers_[static_cast<size_t>(i)];
    Point mean{};
    if (is_open_[static_cast<size_t>(i)] == 0 || neighbour_mean(i, mean) == 0) continue;
    expected_[static_cast<size_t>(i)] = {marker.rest_x.raw() + mean.x, marker.rest_y.raw() + mean.y};
  }
}

void MarkerLattice::fill_lost() {
  for (int ring = 0; ring < size_.n_x + size_.n_y; ++ring) {
    std::copy(known_.begin(), known_.end(), known_next_.begin());
    bool is_complete = true;
    for (int i = 0; i < size_.count(); ++i) {
      if (known_[static_cast<size_t>(i)] != 0) continue;
      Point mean{};
      if (neighbour_mean(i, mean) == 0) {
        is_complete = false;
        continue;
      }
      Marker& marker = markers_[static_cast<size_t>(i)];
      marker.displacement_x = ImagePx::from_raw(static_cast<int32_t>(mean.x));
      marker.displacement_y = ImagePx::from_raw(static_cast<int32_t>(mean.y));
      known_next_[static_cast<size_t>(i)] = 1;
    }
    std::swap(known_, known_next_);
    if (is_complete) return;
  }
}

// Gives every open marker its matched dot.
void MarkerLattice::accept(std::span<const Dot> dots) {
  for (size_t i = 0; i < markers_.size(); ++i) {
    const int j = dot_of_marker_[i].index;
    if (is_open_[i] == 0 || j < 0) continue;
    const Dot& dot = dots[static_cast<size_t>(j)];
    Marker& marker = markers_[i];
    marker.displacement_x = ImagePx::from_raw(dot.x.raw() - marker.rest_x.raw());
    marker.displacement_y = ImagePx::from_raw(dot.y.raw() - marker.rest_y.raw());
    known_[i] = 1;
    is_open_[i] = 0;
    is_dot_taken_[static_cast<size_t>(j)] = 1;
  }
}

int MarkerLattice::track(std::span<const Dot> dots) {
  std::fill(is_dot_taken_.begin(), is_dot_taken_.end(), uint8_t{0});
  std::fill(known_.begin(), known_.end(), uint8_t{0});
  for (size_t i = 0; i < markers_.size(); ++i) {
    const Marker& marker = markers_[i];
    is_open_[i] = marker.is_absent ? 0 : 1;
    expected_[i] = {marker.rest_x.raw() + int64_t{marker.displacement_x.raw()},
                    marker.rest_y.raw() + int64_t{marker.displacement_y.raw()}};
  }
  match(dots, expected_);
  accept(dots);
  expect_with_neighbours();
  match(dots, expected_);
  accept(dots);
  int n_lost = 0;
  for (size_t i = 0; i < markers_.size(); ++i) {
    markers_[i].is_lost = known_[i] == 0;
    n_lost += static_cast<int>(is_open_[i] != 0);
  }
  fill_lost();
  return n_lost;
}

}  // namespace ruffini
