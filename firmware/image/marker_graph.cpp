#include "image/marker_graph.h"

#include <algorithm>

#include "image/markers.h"

namespace ruffini {
namespace {

// True if a third marker is inside the circle with diameter i-j.
bool is_parted(std::span<const ImagePoint> rest, std::span<const uint8_t> is_there, size_t i, size_t j) {
  const int64_t apart2 = distance2(rest[i], rest[j]);
  for (size_t k = 0; k < rest.size(); ++k) {
    if (is_there[k] != 0 && k != i && k != j && distance2(rest[i], rest[k]) + distance2(rest[j], rest[k]) < apart2)
      return true;
  }
  return false;
}

}  // namespace

int take_middle(std::span<const ImagePoint> places, std::span<uint8_t> is_free) {
  ImagePoint mean;
  int n = 0;
  for (size_t i = 0; i < places.size(); ++i) {
    if (is_free[i] == 0) continue;
    mean = {mean.x + places[i].x, mean.y + places[i].y};
    ++n;
  }
  if (n == 0) return 0;
  mean = {floor_div(mean.x, n), floor_div(mean.y, n)};
  size_t best = 0;
  for (size_t i = 0; i < places.size(); ++i) {
    if (is_free[i] != 0 && (is_free[best] == 0 || distance2(places[i], mean) < distance2(places[best], mean))) best = i;
  }
  is_free[best] = 0;
  return static_cast<int>(best);
}

MarkerGraph::MarkerGraph(GridSize lattice) : nodes_(static_cast<size_t>(lattice.count())) {
  const int n_x = lattice.n_x;
  for (int i = 0; i < lattice.count(); ++i) {
    const int x = i % n_x;
    const int y = i / n_x;
    Node& node = nodes_[static_cast<size_t>(i)];
    const auto is_inside = [&](int u, int v) { return u >= 0 && u < n_x && v >= 0 && v < lattice.n_y; };
    for (const auto& [u, v] : {std::array{-1, 0}, {1, 0}, {0, -1}, {0, 1}}) {
      const int step = v * n_x + u;
      if (is_inside(x + u, y + v)) node.beside.add(i + step);
      if (is_inside(x + 2 * u, y + 2 * v)) node.lines.add({i + step, i + 2 * step});
    }
    for (int v = -1; v <= 1; ++v) {
      for (int u = -1; u <= 1; ++u) {
        if ((u != 0 || v != 0) && is_inside(x + u, y + v)) node.around.add(i + v * n_x + u);
      }
    }
  }
}

void MarkerGraph::find_nearest(std::span<const ImagePoint> rest, std::span<const uint8_t> is_there, size_t marker) {
  Few<int>& beside = nodes_[marker].beside;
  beside.n = 0;
  for (size_t j = 0; j < rest.size(); ++j) {
    if (is_there[j] == 0 || j == marker) continue;
    const int64_t apart2 = distance2(rest[marker], rest[j]);
    const auto is_nearer = [&](int other) {
      return distance2(rest[marker], rest[static_cast<size_t>(other)]) > apart2;
    };
    if (beside.n == kMaxNear && !is_nearer(beside.item.back())) continue;
    if (is_parted(rest, is_there, marker, j)) continue;
    const auto end = beside.item.begin() + static_cast<ptrdiff_t>(beside.n);
    const auto at = std::find_if(beside.item.begin(), end, is_nearer);
    beside.n = std::min(beside.n + 1, kMaxNear);
    std::copy_backward(at, beside.item.begin() + static_cast<ptrdiff_t>(beside.n) - 1,
                       beside.item.begin() + static_cast<ptrdiff_t>(beside.n));
    *at = static_cast<int>(j);
  }
}

void MarkerGraph::find_lines(std::span<const ImagePoint> rest, size_t marker) {
  Node& node = nodes_[marker];
  node.lines.n = 0;
  for (const int near : node.beside.view()) {
    const ImagePoint& from = rest[marker];
    const ImagePoint& over = rest[static_cast<size_t>(near)];
    const ImagePoint wanted{2 * over.x - from.x, 2 * over.y - from.y};
    Line line{near, -1};
    int64_t limit2 = distance2(from, over) / 4;
    for (const int far : nodes_[static_cast<size_t>(near)].beside.view()) {
      const int64_t off2 = distance2(rest[static_cast<size_t>(far)], wanted);
      if (far == static_cast<int>(marker) || off2 >= limit2) continue;
      line.far = far;
      limit2 = off2;
    }
    if (line.far >= 0) node.lines.add(line);
  }
}

void MarkerGraph::connect(std::span<const ImagePoint> rest, std::span<const uint8_t> is_there) {
  for (size_t i = 0; i < nodes_.size(); ++i) {
    nodes_[i] = Node{};
    if (is_there[i] != 0) find_nearest(rest, is_there, i);
  }
  // At this point `around` holds the neighbours that list this marker in their `beside`, too.
  for (size_t i = 0; i < nodes_.size(); ++i) {
    for (const int j : nodes_[i].beside.view()) {
      const std::span<const int> back = nodes_[static_cast<size_t>(j)].beside.view();
      if (std::find(back.begin(), back.end(), static_cast<int>(i)) != back.end()) nodes_[i].around.add(j);
    }
  }
  for (Node& node : nodes_) node.beside = node.around;
  for (size_t i = 0; i < nodes_.size(); ++i) find_lines(rest, i);
}

bool MarkerGraph::mean_around(std::span<const Marker> markers, std::span<const uint8_t> known, size_t marker,
                              ImagePoint& mean) const {
  int count = 0;
  mean = {};
  for (const int j : around(marker)) {
    const auto at = static_cast<size_t>(j);
    if (known[at] == 0) continue;
    ++count;
    mean.x += markers[at].displacement_x.raw();
    mean.y += markers[at].displacement_y.raw();
  }
  if (count > 0) mean = {floor_div(mean.x, count), floor_div(mean.y, count)};
  return count > 0;
}

bool MarkerGraph::mean_on_lines(std::span<const Marker> markers, std::span<const uint8_t> known, size_t marker,
                                ImagePoint& mean) const {
  int count = 0;
  mean = {};
  for (const Line& line : lines(marker)) {
    const auto near = static_cast<size_t>(line.near);
    const auto far = static_cast<size_t>(line.far);
    if (known[near] == 0 || known[far] == 0) continue;
    ++count;
    mean.x += int64_t{2} * markers[near].displacement_x.raw() - markers[far].displacement_x.raw();
    mean.y += int64_t{2} * markers[near].displacement_y.raw() - markers[far].displacement_y.raw();
  }
  if (count > 0) mean = {floor_div(mean.x, count), floor_div(mean.y, count)};
  return count > 0;
}

void MarkerGraph::fill(std::span<Marker> markers, std::vector<uint8_t>& known, std::vector<uint8_t>& next) const {
  for (bool has_grown = true; has_grown;) {
    has_grown = false;
    std::copy(known.begin(), known.end(), next.begin());
    for (size_t i = 0; i < markers.size(); ++i) {
      ImagePoint mean;
      if (known[i] != 0 || !mean_around(markers, known, i, mean)) continue;
      markers[i].displacement_x = ImagePx::from_raw(static_cast<int32_t>(mean.x));
      markers[i].displacement_y = ImagePx::from_raw(static_cast<int32_t>(mean.y));
      next[i] = 1;
      has_grown = true;
    }
    std::swap(known, next);
  }
}

}  // namespace ruffini
