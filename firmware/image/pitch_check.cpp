#include "image/pitch_check.h"

#include <cstdlib>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int64_t kTolerancePercent = 15;  // half of a marker's tolerance relative to its neighbours (markers.h)
constexpr int64_t kMinMarkers = 8;
constexpr int kCoarse = 12;  // Q16 to Q4 px: sums of 2^12 products stay below 2^48

struct Place {
  int64_t x = 0;
  int64_t y = 0;
};

}  // namespace

bool pitch_fits(std::span<const Marker> at_rest, const BoardSettings& board) {
  const MarkerSettings& m = board.markers;
  if (m.is_scattered && m.places.empty()) return true;
  const int64_t um_to_px_q32 = floor_div(board.camera.focal_mpx * (int64_t{1} << 32), board.camera.standoff_um * 1000);
  const auto nominal = [&](size_t i) {
    const auto column = static_cast<int64_t>(i) % m.lattice.n_x;
    const auto row = static_cast<int64_t>(i) / m.lattice.n_x;
    const int64_t x_um = m.is_scattered ? m.places[i].x_um : m.first_x_um + column * m.pitch_x_um;
    const int64_t y_um = m.is_scattered ? m.places[i].y_um : m.first_y_um + row * m.pitch_y_um;
    return Place{x_um * um_to_px_q32 >> (16 + kCoarse), y_um * um_to_px_q32 >> (16 + kCoarse)};
  };
  const auto seen = [&](size_t i) {
    return Place{at_rest[i].rest_x.raw() >> kCoarse, at_rest[i].rest_y.raw() >> kCoarse};
  };
  Place mean_e, mean_p;
  int64_t n = 0;
  for (size_t i = 0; i < at_rest.size(); ++i) {
    if (at_rest[i].is_absent) continue;
    const Place e = nominal(i), p = seen(i);
    mean_e = {mean_e.x + e.x, mean_e.y + e.y};
    mean_p = {mean_p.x + p.x, mean_p.y + p.y};
    ++n;
  }
  if (n < kMinMarkers) return true;
  mean_e = {floor_div(mean_e.x, n), floor_div(mean_e.y, n)};
  mean_p = {floor_div(mean_p.x, n), floor_div(mean_p.y, n)};
  int64_t both = 0, own = 0;
  for (size_t i = 0; i < at_rest.size(); ++i) {
    if (at_rest[i].is_absent) continue;
    const Place e = nominal(i), p = seen(i);
    both += (e.x - mean_e.x) * (p.x - mean_p.x) + (e.y - mean_e.y) * (p.y - mean_p.y);
    own += (e.x - mean_e.x) * (e.x - mean_e.x) + (e.y - mean_e.y) * (e.y - mean_e.y);
  }
  return 100 * std::abs(both - own) <= kTolerancePercent * own;
}

}  // namespace ruffini
