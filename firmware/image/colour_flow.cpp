#include "image/colour_flow.h"

#include <algorithm>

#include "base/fixed.h"

namespace ruffini {
namespace {

using flow_kernel::kArea;
using flow_kernel::kSide;

constexpr size_t kNuisances = 6;
constexpr int kGradientFraction = 4;   // of gradients while nuisances are removed
constexpr int kSumFraction = 4;        // of sum h g^T: with it nine blocks stay below 2^32 and 2^28
constexpr int64_t kMinContrast = 36;   // as for grey (flow_templates.cpp), in the same format
constexpr int64_t kMaxStep = 1 << 16;  // Q16 px
constexpr int kHalfHeight = 11;
constexpr int kReach = 22;  // rows sampled: 7 x 3 + 1

}  // namespace

ColourFlow::ColourFlow(GridSize image, size_t n_patches)
    : image_(image),
      kernel_(flow_kernel::fastest_supported()),
      row_(size_t{3} * kColours * static_cast<size_t>(image.n_x)),
      patch_(n_patches),
      h_(n_patches * kColours * 2 * kSamples),
      nuisances_(kSamples, kNuisances) {
  for (auto& picture : picture_) picture.resize(static_cast<size_t>(image.count()));
}

GreyView ColourFlow::view(size_t colour) const {
  return {picture_[colour].data(), image_.n_x, image_.n_y, 1, image_.n_x};
}

// Converts levels times 2^unit_shift / 16 to Q4 and smooths them. The smoothing along x is three rows ahead; borders
// are repeated.
template <typename Level>
void ColourFlow::smooth(const Level* pixels, ptrdiff_t stride, int unit_shift) {
  const auto n = static_cast<ptrdiff_t>(kColours) * image_.n_x;
  constexpr auto step = static_cast<ptrdiff_t>(kColours);
  const auto row_of = [&](int y) { return row_.data() + (y % 3) * n; };
  const auto along_x = [&](int y) {
    const Level* from = pixels + y * stride;
    uint16_t* to = row_of(y);
    for (ptrdiff_t i = 0; i < step; ++i) {
      to[i] = static_cast<uint16_t>(3 * from[i] + from[i + step]);
      to[n - step + i] = static_cast<uint16_t>(from[n - 2 * step + i] + 3 * from[n - step + i]);
    }
    for (ptrdiff_t i = step; i < n - step; ++i) {
      to[i] = static_cast<uint16_t>(from[i - step] + 2 * from[i] + from[i + step]);
    }
  };
  const int half = (1 << unit_shift) >> 1;
  along_x(0);
  for (int y = 0; y < image_.n_y; ++y) {
    if (y + 1 < image_.n_y) along_x(y + 1);
    const uint16_t* above = row_of(std::max(y - 1, 0));
    const uint16_t* here = row_of(y);
    const uint16_t* below = row_of(std::min(y + 1, image_.n_y - 1));
    const ptrdiff_t first = ptrdiff_t{y} * image_.n_x;
    int16_t* to[kColours] = {picture_[0].data() + first, picture_[1].data() + first, picture_[2].data() + first};
    for (ptrdiff_t x = 0; x < image_.n_x; ++x) {
      for (size_t c = 0; c < kColours; ++c) {
        const ptrdiff_t i = x * step + static_cast<ptrdiff_t>(c);
        to[c][x] = static_cast<int16_t>((above[i] + 2 * here[i] + below[i] + half) >> unit_shift);
      }
    }
  }
}

void ColourFlow::learn(std::span<const uint16_t> rest, std::span<const FlowVector> places) {
  smooth(rest.data(), static_cast<ptrdiff_t>(kColours) * image_.n_x, kSumFraction);
  for (size_t i = 0; i < patch_.size(); ++i) learn_patch(i, places[i]);
}

void ColourFlow::sample(const Patch& patch, size_t colour, Samples& out) const {
  const GreyView picture = view(colour);
  for (size_t i = 0; i < kSamples; ++i) {
    const auto in_block = static_cast<int>(i % kArea);
    const int column = static_cast<int>(i / kArea) * kSide + in_block % kSide;
    const int16_t* at = picture.row(patch.y + in_block / kSide * kShape.row_step) + patch.x + column;
    out.value[i] = at[0];
    out.g_x[i] = (at[1] - at[-1]) >> 1;
    out.g_y[i] = (at[picture.stride] - at[-picture.stride]) >> 1;
  }
}

void ColourFlow::add_nuisances(const Patch& patch, const FlowVector& place, const Samples& samples) {
  std::array<int32_t, kSamples> v{};
  nuisances_.clear();
  v.fill(1);
  nuisances_.add(v);
  v = samples.value;
  nuisances_.add(v);
  const auto away = [](int64_t px, int32_t place_q16) { return static_cast<int32_t>(((px << 16) - place_q16) >> 12); };
  for (const auto* g : {&samples.g_x, &samples.g_y}) {
    for (const bool is_along_x : {true, false}) {
      for (size_t i = 0; i < kSamples; ++i) {
        const auto in_block = static_cast<int>(i % kArea);
        const int column = static_cast<int>(i / kArea) * kSide + in_block % kSide;
        const int row = in_block / kSide * kShape.row_step;
        v[i] = (*g)[i] * (is_along_x ? away(patch.x + column, place.x_q16) : away(patch.y + row, place.y_q16));
      }
      nuisances_.add(v);
    }
  }
}

void ColourFlow::learn_patch(size_t number, const FlowVector& place) {
  Patch& patch = patch_[number];
  patch = {};
  const auto pixel = [](int32_t q16) { return static_cast<int>((int64_t{q16} + 32'768) >> 16); };
  patch.x = std::clamp(pixel(place.x_q16) - kShape.columns() / 2, 1, image_.n_x - kShape.columns() - 2);
  patch.y = std::clamp(pixel(place.y_q16) - kHalfHeight, 1, image_.n_y - kReach - 2);
  std::array<int64_t, 4> information{};
  for (size_t colour = 0; colour < kColours; ++colour) {
    Samples samples;
    sample(patch, colour, samples);
    add_nuisances(patch, place, samples);
    int16_t* h = gradient(number, colour);
    for (size_t axis = 0; axis < 2; ++axis) {
      std::array<int32_t, kSamples> free = axis == 0 ? samples.g_x : samples.g_y;
      for (int32_t& g : free) g *= 1 << kGradientFraction;
      nuisances_.remove(free);
      int64_t misfit = 0;
      for (size_t i = 0; i < kSamples; ++i) {
        const auto one = std::clamp<int64_t>(round_shift(free[i], kGradientFraction), -flow_kernel::kMaxGradient,
                                             flow_kernel::kMaxGradient);
        h[i / kArea * 2 * kArea + axis * kArea + i % kArea] = static_cast<int16_t>(one);
        misfit += one * samples.value[i];
        information[2 * axis] += one * samples.g_x[i];
        information[2 * axis + 1] += one * samples.g_y[i];
      }
      (axis == 0 ? patch.s0_x : patch.s0_y) += misfit;
    }
  }
  for (int64_t& sum : information) sum >>= kSumFraction;
  patch.inverse = invert_flow(information, kMinContrast * static_cast<int64_t>(kColours * kSamples));
}

bool ColourFlow::is_inside(int64_t x_q16, int64_t y_q16) const {
  const int64_t last_x = int64_t{image_.n_x - kShape.columns() - 1} << 16;
  const int64_t last_y = int64_t{image_.n_y - kReach - 1} << 16;
  return x_q16 >= 0 && x_q16 <= last_x && y_q16 >= 0 && y_q16 <= last_y;
}

void ColourFlow::step(const FrameView& frame, std::span<FlowVector> u, std::span<uint8_t> is_cut,
                      std::span<uint8_t> quality) {
  smooth(frame.data, frame.stride, 0);
  for (size_t number = 0; number < patch_.size(); ++number) {
    const Patch& patch = patch_[number];
    const int64_t at_x = (int64_t{patch.x} << 16) + u[number].x_q16;
    const int64_t at_y = (int64_t{patch.y} << 16) + u[number].y_q16;
    if (patch.inverse.shift == 0 || !is_inside(at_x, at_y)) continue;
    int64_t x = -patch.s0_x;
    int64_t y = -patch.s0_y;
    for (size_t colour = 0; colour < kColours; ++colour) {
      for (int b = 0; b < kShape.n_blocks; ++b) {
        const auto sums =
            kernel_.gradient(block_at(view(colour), kShape, at_x, at_y, b), gradient(number, colour) + 2 * kArea * b);
        x += sums.x;
        y += sums.y;
      }
    }
    const auto& k = patch.inverse.k;
    const auto way = [&](int64_t k_x, int64_t k_y) {
      const int64_t full = round_shift(k_x * x + k_y * y, patch.inverse.shift + kSumFraction);
      if (full >= kMaxStep || full <= -kMaxStep) is_cut[number] = 1;
      return std::clamp<int64_t>(full, -kMaxStep, kMaxStep);
    };
    u[number].x_q16 -= static_cast<int32_t>(way(k[0], k[1]));
    u[number].y_q16 -= static_cast<int32_t>(way(k[2], k[3]));
    // 255 / (1 + e^2) for two thirds of the error e.
    const int q = quality[number];
    quality[number] = static_cast<uint8_t>(255 * 9 * q / (5 * q + 4 * 255));
  }
}

}  // namespace ruffini
