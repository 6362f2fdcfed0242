#include "stages/depth_moments/depth_moments.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr int kPlaceBits = 11;  // of X and Y, |X| <= 1: the window is inside the pad
constexpr int kFineBits = 11;   // of 1/8 um
constexpr int kShareBits = 24;
constexpr int64_t kMaxDepth = int64_t{1} << 15;
constexpr int64_t kMaxCells = int64_t{640} * 640;  // board/cross_check.cpp
static_assert(kMaxCells * kMaxDepth < int64_t{1} << (61 - 2 * kPlaceBits));
static_assert(kMaxCells << kShareBits < int64_t{1} << 61);
static_assert(kPlaceBits == kFineBits, "a mean of e X is in the unit of the features");

int64_t mean(int64_t sum, int64_t n) { return floor_div(2 * sum + n, 2 * n); }

}  // namespace

DepthMoments::DepthMoments(const BoardSettings& b)
    : n_x_(static_cast<size_t>(b.camera.width_px / b.depth.step_px)),
      x_(axis(b.camera.width_px / b.depth.step_px, b.depth.step_px, b.camera.center_x_mpx, b.camera, b.window.min_x_um,
              b.window.max_x_um, b.pad.size_x_um)),
      y_(axis(b.camera.height_px / b.depth.step_px, b.depth.step_px, b.camera.center_y_mpx, b.camera, b.window.min_y_um,
              b.window.max_y_um, b.pad.size_y_um)) {}

DepthMoments::Axis DepthMoments::axis(int n, int step_px, int64_t center_mpx, const CameraSettings& camera,
                                      int64_t min_um, int64_t max_um, int64_t size_um) {
  Axis out;
  for (int i = 0; i < n; ++i) {
    const int64_t middle_mpx = (int64_t{2} * i * step_px + step_px - 1) * 500;
    const int64_t place_um = floor_div((middle_mpx - center_mpx) * camera.standoff_um, camera.focal_mpx);
    const int64_t from_corner_um = place_um + size_um / 2;
    if (from_corner_um < min_um || from_corner_um > max_um) continue;
    if (out.place_q11.empty()) out.first = static_cast<size_t>(i);
    out.place_q11.push_back(static_cast<int32_t>(floor_div(place_um * (2 << kPlaceBits), size_um)));
  }
  return out;
}

void DepthMoments::run(std::span<const DisplacementUm> depth, std::span<int32_t, kCount> features) const {
  int64_t volume = 0, n_touched = 0, x = 0, y = 0, xx = 0, yy = 0, xy = 0;
  int32_t deepest = 0;
  for (size_t j = 0; j < y_.place_q11.size(); ++j) {
    const DisplacementUm* row = depth.data() + (y_.first + j) * n_x_ + x_.first;
    int64_t of_row = 0, row_x = 0;
    for (size_t i = 0; i < x_.place_q11.size(); ++i) {
      const int32_t e = -row[i].raw() - kLeast;
      if (e <= 0) continue;
      const int64_t e_x = int64_t{e} * x_.place_q11[i];
      of_row += e;
      row_x += e_x;
      xx += e_x * x_.place_q11[i];
      ++n_touched;
      deepest = std::max(deepest, e);
    }
    const int64_t place_y = y_.place_q11[j];
    volume += of_row;
    x += row_x;
    y += of_row * place_y;
    yy += of_row * place_y * place_y;
    xy += row_x * place_y;
  }
  const auto n = std::max<int64_t>(static_cast<int64_t>(x_.place_q11.size() * y_.place_q11.size()), 1);
  const std::array<int64_t, kCount> all = {mean(volume << kFineBits, n),
                                           mean(n_touched << kShareBits, n),
                                           int64_t{deepest} << kFineBits,
                                           mean(x, n),
                                           mean(y, n),
                                           mean(xx, n << kPlaceBits),
                                           mean(yy, n << kPlaceBits),
                                           mean(xy, n << kPlaceBits)};
  std::transform(all.begin(), all.end(), features.begin(), [](int64_t f) { return static_cast<int32_t>(f); });
}

}  // namespace ruffini
