#include "image/markers.h"

#include <algorithm>
#include <numeric>

#include "image/marker_quality.h"
namespace ruffini {
namespace {

int64_t px_q16(int64_t mpx) { return floor_div(mpx * 65536 + 500, 1000); }

// Converts a length in the undeformed surface to pixels, Q16.
int64_t length_q16(const CameraSettings& camera, int64_t um) {
  return floor_div(um * camera.focal_mpx * 65536, camera.standoff_um * 1000);
}

// Upper bound of the square root, Q16 px; lengths stay below 2^30.
int64_t gate_of(int64_t gate2) {
  int64_t gate = 1;
  while (gate * gate < gate2) gate *= 2;
  return gate;
}

// Number of markers along the shorter side. The markers of a view are listed in one row, so a square of as many counts.
int row_of(GridSize size) {
  if (size.n_y > 1) return std::min(size.n_x, size.n_y);
  int row = 1;
  while ((row + 1) * (row + 1) <= size.n_x) ++row;
  return row;
}

constexpr int kRings = 16;            // of neighbours that predict a marker
constexpr int64_t kApartWeight = 16;  // weight of differences between neighbours, relative to the motion of one marker
constexpr int64_t kMissingWeight = 16;  // pitches squared
constexpr int64_t kLeftWeight = 8;      // pitches squared
constexpr int kDoubtPercent = 33;       // of the pitch

}  // namespace

DotParameters dot_parameters(const BoardSettings& board) {
  const MarkerSettings& m = board.markers;
  const int64_t pitch = length_q16(board.camera, std::min(m.pitch_x_um, m.pitch_y_um));
  const int64_t diameter = length_q16(board.camera, m.diameter_um);
  // Area of the disc, px: pi / 4 d^2, with pi / 4 = 201 / 256.
  const int64_t area = ((diameter * diameter >> 16) * 201 / 256) >> 16;
  return {.width_px = board.camera.width_px,
          .height_px = board.camera.height_px,
          .box_radius_px = static_cast<int>(std::clamp<int64_t>(pitch * 6 / 10 >> 16, 2, DotDetector::kMaxBoxRadiusPx)),
          .threshold_1e3 = static_cast<int>(m.threshold_1e3),
          .polarity = m.polarity,
          .min_area_px = static_cast<int>(std::max<int64_t>(area / 4, 4)),
          .max_area_px = static_cast<int>(std::max<int64_t>(area * 3, 16))};
}

MarkerTracker::MarkerTracker(const BoardSettings& board)
    : size_(board.markers.lattice),
      graph_(size_),
      is_scattered_(board.markers.is_scattered),
      is_listed_(!board.markers.is_scattered || !board.markers.places.empty()) {
  many_unmatched_ = row_of(size_);
  const CameraSettings& camera = board.camera;
  const int64_t pitch = length_q16(camera, std::min(board.markers.pitch_x_um, board.markers.pitch_y_um));
  const auto squared_share = [pitch](int64_t percent) { return (pitch * percent / 100) * (pitch * percent / 100); };
  gate2_ = squared_share(45);
  seed_gate2_ = squared_share(60);  // 0.4 pitch along both axes
  step_gate2_ = squared_share(35);
  tight_gate2_ = squared_share(25);
  search2_ = squared_share(is_scattered_ ? 200 : 110);
  pitch_q8_ = pitch >> 8;
  view_ = {int64_t{camera.width_px} << 16, int64_t{camera.height_px} << 16};
  edge_ = length_q16(camera, board.markers.diameter_um);
  const auto n = static_cast<size_t>(size_.count());
  markers_.resize(n);
  expected_.resize(n);
  dot_of_marker_.resize(n);
  is_open_.resize(n);
  is_led_.resize(n);
  queue_.resize(n);
  known_.resize(n);
  known_next_.resize(n);
  area_.resize(n);
  rest_area_.resize(n);
  best_area_.resize(n);
  last_.resize(n);
  best_.resize(n);
  best_known_.resize(n);
  nominal_.resize(n);
  marker_of_dot_.resize(DotDetector::kMaxDots);
  is_dot_taken_.resize(DotDetector::kMaxDots);
  by_height_.resize(DotDetector::kMaxDots);
  if (is_listed_ && n > 0) place_nominal(board);
}

// Nominal positions of the lattice or list in the board's camera, and the markers that growth may start from.
void MarkerTracker::place_nominal(const BoardSettings& board) {
  const MarkerSettings& m = board.markers;
  const CameraSettings& camera = board.camera;
  const int64_t um_to_px_q32 = floor_div(camera.focal_mpx * (int64_t{1} << 32), camera.standoff_um * 1000);
  const Point corner{px_q16(camera.center_x_mpx) - (board.pad.size_x_um * um_to_px_q32 >> 17),
                     px_q16(camera.center_y_mpx) - (board.pad.size_y_um * um_to_px_q32 >> 17)};
  for (int i = 0; i < size_.count(); ++i) {
    const PadPlace at = m.is_scattered ? m.places[static_cast<size_t>(i)]
                                       : PadPlace{m.first_x_um + (i % size_.n_x) * m.pitch_x_um,
                                                  m.first_y_um + (i / size_.n_x) * m.pitch_y_um};
    nominal_[static_cast<size_t>(i)] = {corner.x + (at.x_um * um_to_px_q32 >> 16),
                                        corner.y + (at.y_um * um_to_px_q32 >> 16)};
  }
  if (!m.is_scattered) {
    const int middle = (size_.n_y / 2) * size_.n_x + size_.n_x / 2;
    seeds_ = {middle, middle - 1, middle - size_.n_x, middle - size_.n_x - 1};
    return;
  }
  std::fill(known_.begin(), known_.end(), uint8_t{1});
  graph_.connect(nominal_, known_);
  for (int& seed : seeds_) seed = take_middle(nominal_, known_);
}

// Matches mutual nearest neighbours within the gate, among open markers and dots that are not taken.
void MarkerTracker::match(std::span<const Dot> dots, int64_t gate2) {
  const int64_t reach = gate_of(gate2);
  std::fill(dot_of_marker_.begin(), dot_of_marker_.end(), Nearest{-1, gate2});
  std::fill_n(marker_of_dot_.begin(), dots.size(), Nearest{-1, gate2});
  for (int i = 0; i < size_.count(); ++i) {
    if (is_open_[static_cast<size_t>(i)] == 0 || is_led_[static_cast<size_t>(i)] == 0) continue;
    const Point& place = expected_[static_cast<size_t>(i)];
    Nearest& mine = dot_of_marker_[static_cast<size_t>(i)];
    const auto end = by_height_.begin() + std::ssize(dots);
    auto at = std::partition_point(by_height_.begin(), end,
                                   [&](int j) { return dots[static_cast<size_t>(j)].y.raw() < place.y - reach; });
    for (; at != end && dots[static_cast<size_t>(*at)].y.raw() <= place.y + reach; ++at) {
      const int j = *at;
      const int64_t dx = dots[static_cast<size_t>(j)].x.raw() - place.x;
      const int64_t dy = dots[static_cast<size_t>(j)].y.raw() - place.y;
      const int64_t apart2 = dx * dx + dy * dy;
      if (is_dot_taken_[static_cast<size_t>(j)] != 0) continue;
      if (apart2 < mine.distance2 || (apart2 == mine.distance2 && j < mine.index)) mine = {j, apart2};
      Nearest& theirs = marker_of_dot_[static_cast<size_t>(j)];
      if (apart2 < theirs.distance2) theirs = {i, apart2};
    }
  }
  for (int i = 0; i < size_.count(); ++i) {
    Nearest& mine = dot_of_marker_[static_cast<size_t>(i)];
    if (mine.index >= 0 && marker_of_dot_[static_cast<size_t>(mine.index)].index != i) mine.index = -1;
  }
}

// Index of the nearest free dot closer than sqrt(limit2) to `place`; -1: none.
int MarkerTracker::nearest_free(std::span<const Dot> dots, const Point& place, int64_t limit2) const {
  int best = -1;
  for (size_t j = 0; j < dots.size(); ++j) {
    const int64_t dx = dots[j].x.raw() - place.x;
    const int64_t dy = dots[j].y.raw() - place.y;
    const int64_t apart2 = dx * dx + dy * dy;
    if (is_dot_taken_[j] != 0 || apart2 >= limit2) continue;
    best = static_cast<int>(j);
    limit2 = apart2;
  }
  return best;
}

// Each dot becomes a marker while there is room; unused places lie outside the picture.
int MarkerTracker::take_all(std::span<const Dot> dots) {
  const size_t n = std::min(dots.size(), markers_.size());
  for (size_t i = 0; i < markers_.size(); ++i) {
    Marker& marker = markers_[i] = Marker{};
    marker.is_absent = marker.is_lost = i >= n;
    rest_area_[i] = i < n ? dots[i].area_px : 1;
    known_[i] = i < n ? 1 : 0;
    marker.rest_x = i < n ? dots[i].x : ImagePx::from_raw(static_cast<int32_t>(-edge_));
    marker.rest_y = i < n ? dots[i].y : ImagePx::from_raw(static_cast<int32_t>(-edge_));
    nominal_[i] = {marker.rest_x.raw(), marker.rest_y.raw()};
  }
  graph_.connect(nominal_, known_);
  middle_ = take_middle(nominal_, known_);
  return static_cast<int>(n);
}

// Assigns dots outwards from `seed`: each neighbour is expected one nominal step from a marker that has its dot.
// Returns the number of markers found.
int MarkerTracker::grow(std::span<const Dot> dots, int seed) {
  std::fill(dot_of_marker_.begin(), dot_of_marker_.end(), Nearest{-1, 0});
  std::fill(is_dot_taken_.begin(), is_dot_taken_.end(), uint8_t{0});
  int n_found = 0;
  const auto assign = [&](int marker, int dot) {
    if (dot < 0) return;
    dot_of_marker_[static_cast<size_t>(marker)].index = dot;
    is_dot_taken_[static_cast<size_t>(dot)] = 1;
    queue_[static_cast<size_t>(n_found++)] = marker;
  };
  assign(seed, nearest_free(dots, nominal_[static_cast<size_t>(seed)], seed_gate2_));
  for (int next = 0; next < n_found; ++next) {
    const int at = queue_[static_cast<size_t>(next)];
    const Dot& dot = dots[static_cast<size_t>(dot_of_marker_[static_cast<size_t>(at)].index)];
    const Point& from = nominal_[static_cast<size_t>(at)];
    for (const int neighbour : graph_.beside(static_cast<size_t>(at))) {
      if (dot_of_marker_[static_cast<size_t>(neighbour)].index >= 0) continue;
      const Point& to = nominal_[static_cast<size_t>(neighbour)];
      assign(neighbour, nearest_free(dots, {dot.x.raw() + to.x - from.x, dot.y.raw() + to.y - from.y}, step_gate2_));
    }
  }
  return n_found;
}

int MarkerTracker::learn(std::span<const Dot> dots) {
  if (!is_listed_) return take_all(dots);
  // The seed decides the assignment, and a central marker may have no dot, or dust instead of one.
  int best_seed = seeds_[0];
  int best_found = 0;
  for (const int seed : seeds_) {
    const int n_found = grow(dots, seed);
    if (n_found > best_found) {
      best_found = n_found;
      best_seed = seed;
    }
  }
  grow(dots, best_seed);
  Point shift{0, 0};  // mean over the markers found, for the positions of the absent ones
  for (int n = 0; n < best_found; ++n) {
    const int i = queue_[static_cast<size_t>(n)];
    const Dot& dot = dots[static_cast<size_t>(dot_of_marker_[static_cast<size_t>(i)].index)];
    shift.x += dot.x.raw() - nominal_[static_cast<size_t>(i)].x;
    shift.y += dot.y.raw() - nominal_[static_cast<size_t>(i)].y;
  }
  if (best_found > 0) shift = {floor_div(shift.x, best_found), floor_div(shift.y, best_found)};
  for (int i = 0; i < size_.count(); ++i) {
    const int j = dot_of_marker_[static_cast<size_t>(i)].index;
    const Point& place = nominal_[static_cast<size_t>(i)];
    Marker& marker = markers_[static_cast<size_t>(i)];
    marker = Marker{};
    marker.is_absent = marker.is_lost = j < 0;
    rest_area_[static_cast<size_t>(i)] = j < 0 ? 1 : dots[static_cast<size_t>(j)].area_px;
    marker.rest_x = j < 0 ? ImagePx::from_raw(static_cast<int32_t>(place.x + shift.x)) : dots[static_cast<size_t>(j)].x;
    marker.rest_y = j < 0 ? ImagePx::from_raw(static_cast<int32_t>(place.y + shift.y)) : dots[static_cast<size_t>(j)].y;
  }
  middle_ = best_seed;  // it has its dot, if any has
  return best_found;
}

void MarkerTracker::expect_with_neighbours() {
  for (size_t i = 0; i < markers_.size(); ++i) {
    Point mean;
    if (is_open_[i] == 0) continue;
    if (!graph_.mean_on_lines(markers_, known_, i, mean) && !graph_.mean_around(markers_, known_, i, mean)) continue;
    expected_[i] = {markers_[i].rest_x.raw() + mean.x, markers_[i].rest_y.raw() + mean.y};
    is_led_[i] = 1;
  }
}

// Gives every open marker its matched dot. Returns their number.
int MarkerTracker::accept(std::span<const Dot> dots) {
  int n_accepted = 0;
  for (size_t i = 0; i < markers_.size(); ++i) {
    const int j = dot_of_marker_[i].index;
    if (is_open_[i] == 0 || j < 0) continue;
    const Dot& dot = dots[static_cast<size_t>(j)];
    Marker& marker = markers_[i];
    marker.displacement_x = ImagePx::from_raw(dot.x.raw() - marker.rest_x.raw());
    marker.displacement_y = ImagePx::from_raw(dot.y.raw() - marker.rest_y.raw());
    area_[i] = dot.area_px;
    known_[i] = 1;
    is_open_[i] = 0;
    is_dot_taken_[static_cast<size_t>(j)] = 1;
    ++n_accepted;
  }
  return n_accepted;
}

// Assigns dots around rest + start(marker), to all markers or only to `seed`, then along the neighbours' motion.
template <typename Start>
void MarkerTracker::follow(std::span<const Dot> dots, Start start, int64_t gate2, int seed) {
  std::fill(is_led_.begin(), is_led_.end(), seed < 0 ? uint8_t{1} : uint8_t{0});
  if (seed >= 0) is_led_[static_cast<size_t>(seed)] = 1;
  std::fill(is_dot_taken_.begin(), is_dot_taken_.end(), uint8_t{0});
  std::fill(known_.begin(), known_.end(), uint8_t{0});
  auto n_open = std::ssize(markers_);
  for (size_t i = 0; i < markers_.size(); ++i) {
    const Marker& marker = markers_[i];
    const Point at = start(i);
    is_open_[i] = marker.is_absent ? 0 : 1;
    n_open -= marker.is_absent ? 1 : 0;
    expected_[i] = {marker.rest_x.raw() + at.x, marker.rest_y.raw() + at.y};
  }
  match(dots, gate2);
  int n_found = accept(dots);
  auto n_known = n_found;
  // For markers led by neighbours, the tight gate comes first, because its matches predict further ones. On a lattice
  // the wide gate follows.
  bool is_wide = n_found == 0;
  const int n_rings = is_scattered_ ? size_.count() : kRings;
  for (int ring = 0; ring < n_rings && n_known > 0 && n_known < n_open; ++ring) {
    expect_with_neighbours();
    match(dots, is_wide && !is_scattered_ ? gate2_ : tight_gate2_);
    n_found = accept(dots);
    n_known += n_found;
    if (n_found == 0 && (is_wide || is_scattered_)) break;
    is_wide = n_found == 0;
  }
}

// Sums stay below 2^62: displacements are at most 2^21 in Q8, and there are at most 4,096 markers.
MarkerTracker::AssignmentCost MarkerTracker::assess(size_t n_dots) const {
  AssignmentCost assignment;
  const auto apart2 = [&](size_t i, size_t j) {
    if (known_[i] == 0 || known_[j] == 0) return int64_t{0};
    const int64_t x = (markers_[i].displacement_x.raw() - int64_t{markers_[j].displacement_x.raw()}) >> 8;
    const int64_t y = (markers_[i].displacement_y.raw() - int64_t{markers_[j].displacement_y.raw()}) >> 8;
    return x * x + y * y;
  };
  for (size_t i = 0; i < markers_.size(); ++i) {
    for (const int neighbour : graph_.beside(i)) {
      const auto j = static_cast<size_t>(neighbour);
      const int64_t apart = j > i ? apart2(i, j) : 0;  // each pair once
      assignment.cost += kApartWeight * apart;
      assignment.widest2 = std::max(assignment.widest2, apart);
    }
    if (known_[i] != 0) {
      const int64_t x = markers_[i].displacement_x.raw() >> 8;
      const int64_t y = markers_[i].displacement_y.raw() >> 8;
      assignment.cost += x * x + y * y;
      ++assignment.n_known;
    } else if (is_open_[i] != 0) {
      const Point& at = expected_[i];
      assignment.n_missing +=
          static_cast<int>(at.x >= edge_ && at.y >= edge_ && at.x < view_.x - edge_ && at.y < view_.y - edge_);
    }
  }
  assignment.n_unmatched = static_cast<int>(n_dots) - assignment.n_known;
  assignment.cost +=
      pitch_q8_ * pitch_q8_ * (kMissingWeight * assignment.n_missing + kLeftWeight * assignment.n_unmatched);
  return assignment;
}

bool MarkerTracker::is_ambiguous(const AssignmentCost& assignment) const {
  const int64_t limit2 = pitch_q8_ * pitch_q8_ * (kDoubtPercent * kDoubtPercent) / 10'000;
  if (assignment.n_missing > 0 || assignment.widest2 > limit2 || 2 * assignment.n_unmatched >= many_unmatched_)
    return true;
  for (size_t i = 0; i < markers_.size(); ++i) {
    const int64_t x = (markers_[i].displacement_x.raw() - last_[i].x) >> 8;
    const int64_t y = (markers_[i].displacement_y.raw() - last_[i].y) >> 8;
    if (known_[i] != 0 && x * x + y * y > limit2) return true;
  }
  return false;
}

// Matches the lattice to the dots without memory. Keeps the cheapest assignment, including the current one.
void MarkerTracker::search(std::span<const Dot> dots, int64_t cost_so_far) {
  const auto keep = [&] {
    for (size_t i = 0; i < markers_.size(); ++i) {
      best_[i] = {markers_[i].displacement_x.raw(), markers_[i].displacement_y.raw()};
    }
    std::copy(known_.begin(), known_.end(), best_known_.begin());
    std::copy(area_.begin(), area_.end(), best_area_.begin());
  };
  int n_known = 0;  // of the cheapest assignment
  const auto attempt = [&](Point shift, int seed) {
    follow(dots, [&](size_t) { return shift; }, tight_gate2_, seed);
    const AssignmentCost assignment = assess(dots.size());
    if (assignment.n_known == 0 || assignment.cost >= cost_so_far) return;
    cost_so_far = assignment.cost;
    n_known = assignment.n_known;
    keep();
  };
  const auto attempt_from = [&](int seed) {
    const Marker& first = markers_[static_cast<size_t>(seed)];
    for (const Dot& dot : dots) {
      const Point shift{dot.x.raw() - int64_t{first.rest_x.raw()}, dot.y.raw() - int64_t{first.rest_y.raw()}};
      if (shift.x * shift.x + shift.y * shift.y < search2_) attempt(shift, is_scattered_ ? seed : -1);
    }
  };
  keep();
  attempt({0, 0}, -1);
  attempt_from(middle_);
  // An assignment grown from one marker depends on that marker's dot: if it was wrong, its neighbours are tried.
  for (const int seed : graph_.beside(static_cast<size_t>(middle_))) {
    if (is_scattered_ && 2 * n_known < std::ssize(dots)) attempt_from(seed);
  }
  std::copy(best_known_.begin(), best_known_.end(), known_.begin());
  std::copy(best_area_.begin(), best_area_.end(), area_.begin());
  for (size_t i = 0; i < markers_.size(); ++i) {
    const Point& at = known_[i] != 0 ? best_[i] : last_[i];
    markers_[i].displacement_x = ImagePx::from_raw(static_cast<int32_t>(at.x));
    markers_[i].displacement_y = ImagePx::from_raw(static_cast<int32_t>(at.y));
  }
}

std::span<Marker> MarkerTracker::assign(std::span<const Dot> dots) {
  for (size_t i = 0; i < markers_.size(); ++i) {
    last_[i] = {markers_[i].displacement_x.raw(), markers_[i].displacement_y.raw()};
  }
  std::iota(by_height_.begin(), by_height_.begin() + std::ssize(dots), 0);
  std::sort(by_height_.begin(), by_height_.begin() + std::ssize(dots),
            [&](int a, int b) { return dots[static_cast<size_t>(a)].y.raw() < dots[static_cast<size_t>(b)].y.raw(); });
  follow(dots, [&](size_t i) { return last_[i]; }, is_scattered_ ? tight_gate2_ : gate2_, -1);
  const AssignmentCost assignment = assess(dots.size());
  if (is_ambiguous(assignment)) search(dots, assignment.n_known > 0 ? assignment.cost : INT64_MAX);
  for (size_t i = 0; i < markers_.size(); ++i) markers_[i].is_lost = known_[i] == 0;
  return markers_;
}

int MarkerTracker::finish(std::span<const int64_t> error2_q16) {
  set_marker_quality(graph_, {area_, rest_area_}, error2_q16, pitch_q8_, markers_, known_);
  int n_lost = 0;
  for (size_t i = 0; i < markers_.size(); ++i) {
    markers_[i].is_lost = known_[i] == 0;
    n_lost += static_cast<int>(known_[i] == 0 && !markers_[i].is_absent);
  }
  graph_.fill(markers_, known_, known_next_);
  return n_lost;
}

}  // namespace ruffini
