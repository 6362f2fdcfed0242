#include "stages/picture_features/picture_features.h"

#include <algorithm>
#include <bit>
#include <cstdlib>

namespace ruffini {
namespace {

constexpr int kFine = 4;         // of the means: Q12 to Q16
constexpr int kWeightBits = 30;  // of k
constexpr int kOutside = -1;

// Homogeneous: a point (x, y, w), or a line that is zero where a x + b y + c w is.
using Triple = std::array<int64_t, 3>;

Triple cross(const Triple& a, const Triple& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
int64_t dot(const Triple& a, const Triple& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// One coordinate on the gel, between two opposite edges.
class Axis {
 public:
  // `low`, `high`: lines of the edges where the coordinate is 0 and 1; the other two edges meet at `vanishing`. Places
  // are below 2^12, lines below 2^25, so that distances to `vanishing` stay below 2^63.
  Axis(const Triple& low, const Triple& high, const Triple& vanishing)
      : low_(low), high_(high), low_weight_(dot(high, vanishing)), high_weight_(-dot(low, vanishing)) {
    const auto size = static_cast<uint64_t>(std::max(std::abs(low_weight_), std::abs(high_weight_)));
    const int excess = std::max(static_cast<int>(std::bit_width(size)) - kWeightBits, 0);
    low_weight_ >>= excess;
    high_weight_ >>= excess;
  }

  // Which of n equal parts a pixel lies in, or kOutside.
  [[nodiscard]] int part_of(const Triple& pixel, int n) const {
    int64_t a = dot(low_, pixel) * low_weight_;
    int64_t whole = a + dot(high_, pixel) * high_weight_;
    if (whole < 0) {
      a = -a;
      whole = -whole;
    }
    return a < 0 || a >= whole ? kOutside : static_cast<int>(n * a / whole);
  }

 private:
  Triple low_;
  Triple high_;
  int64_t low_weight_;
  int64_t high_weight_;
};

}  // namespace

PictureFeatures::PictureFeatures(const PictureFeatureSettings& s, int width_px, int height_px)
    : n_pixels_(static_cast<size_t>(s.cells.count())), sum_(n_pixels_.size()) {
  std::array<Triple, 4> corner{};
  std::transform(s.corners.begin(), s.corners.end(), corner.begin(),
                 [](const PicturePlace& p) { return Triple{p.x_px, p.y_px, 1}; });
  const Triple top = cross(corner[0], corner[1]);
  const Triple right = cross(corner[1], corner[2]);
  const Triple bottom = cross(corner[3], corner[2]);
  const Triple left = cross(corner[0], corner[3]);
  const Axis across(left, right, cross(top, bottom));
  const Axis down(top, bottom, cross(left, right));
  for (int y = 0; y < height_px; ++y) {
    int before = kOutside;
    for (int x = 0; x < width_px; ++x) {
      const Triple pixel{x, y, 1};
      const int i = across.part_of(pixel, s.cells.n_x);
      const int j = down.part_of(pixel, s.cells.n_y);
      const int cell = i == kOutside || j == kOutside ? kOutside : j * s.cells.n_x + i;
      if (cell != kOutside) {
        if (cell != before)
          runs_.push_back({static_cast<size_t>(y) * static_cast<size_t>(width_px) + static_cast<size_t>(x), 0, cell});
        ++runs_.back().length;
        ++n_pixels_[static_cast<size_t>(cell)];
      }
      before = cell;
    }
  }
}

void PictureFeatures::run(std::span<const RelativeChange> change, std::span<int32_t> features) {
  const size_t n_plane = change.size() / kChannels;
  for (size_t channel = 0; channel < kChannels; ++channel) {
    const RelativeChange* plane = change.data() + channel * n_plane;
    std::fill(sum_.begin(), sum_.end(), 0);
    for (const Run& run : runs_) {
      int32_t sum = 0;  // of at most 4,096 values of 16 bits
      for (const RelativeChange& d : std::span(plane + run.first, static_cast<size_t>(run.length))) sum += d.raw();
      sum_[static_cast<size_t>(run.cell)] += sum;
    }
    for (size_t k = 0; k < sum_.size(); ++k) {
      const int64_t n = std::max<int64_t>(n_pixels_[k], 1);
      features[channel * sum_.size() + k] = static_cast<int32_t>(floor_div((sum_[k] << (kFine + 1)) + n, 2 * n));
    }
  }
}

}  // namespace ruffini
