#include "image/flow_templates.h"

#include <algorithm>
#include <array>

#include "base/fixed.h"

namespace ruffini {
namespace {

using flow_kernel::kArea;
using flow_kernel::kSide;

constexpr int64_t kMinContrast = 576;    // squared Q4 gradient per sample: 1.5 grey levels a pixel
constexpr int64_t kMaxStep = 1 << 16;    // Q16 px
constexpr int64_t kHalfError2 = 10'486;  // (0.1 px)^2, Q20

int64_t div_round(int64_t a, int64_t n) { return floor_div(2 * a + n, 2 * n); }

}  // namespace

flow_kernel::Block block_at(const GreyView& picture, const PatchShape& shape, int64_t x_q16, int64_t y_q16,
                            int number) {
  const int64_t limit_x = int64_t{picture.width - shape.columns() - 1} << 16;
  const int64_t limit_y = int64_t{picture.height - (kSide - 1) * shape.row_step - 2} << 16;
  const int64_t x = std::clamp<int64_t>(x_q16, 0, limit_x);
  const int64_t y = std::clamp<int64_t>(y_q16, 0, limit_y);
  return {picture.row(static_cast<int>(y >> 16)) + (x >> 16) + ptrdiff_t{number} * kSide, picture.stride,
          picture.stride * shape.row_step, static_cast<int16_t>((x & 0xFFFF) >> 1),
          static_cast<int16_t>((y & 0xFFFF) >> 1)};
}

FlowTemplates::FlowTemplates(PatchShape shape, int n_patches)
    : shape_(shape),
      kernel_(flow_kernel::fastest_supported()),
      patch_(static_cast<size_t>(n_patches)),
      h_(patch_.size() * static_cast<size_t>(2 * shape.n_samples())),
      t_(patch_.size() * static_cast<size_t>(shape.n_samples())),
      value_(t_.size()) {}

void FlowTemplates::learn(const GreyView& picture, std::span<const FlowVector> places) {
  const auto first = [](int64_t center_q16, int size, int margin, int limit) {
    const auto middle = static_cast<int>((center_q16 + 32'768) >> 16);
    return std::clamp(middle - size / 2, margin, limit - size - margin);
  };
  for (size_t i = 0; i < patch_.size(); ++i) {
    patch_[i].x = first(places[i].x_q16, shape_.columns(), shape_.margin_px, picture.width);
    patch_[i].y = first(places[i].y_q16, shape_.rows(), shape_.margin_px, picture.height);
    learn_patch(picture, i);
  }
}

// Computes h along one axis, in the order of t.
void FlowTemplates::remove_nuisances(std::span<const int32_t> g, const int16_t* t, int64_t tt, size_t axis,
                                     int16_t* h) const {
  const auto n = static_cast<size_t>(shape_.n_samples());
  int64_t sum = 0;
  for (size_t i = 0; i < n; ++i) sum += g[i];
  const int64_t mean = div_round(sum, static_cast<int64_t>(n));
  int64_t product = 0;
  for (size_t i = 0; i < n; ++i) product += (g[i] - mean) * t[i];
  const int64_t share_q16 = floor_div(product * 65'536, std::max<int64_t>(tt, 1));
  for (size_t i = 0; i < n; ++i) {
    const int64_t free = g[i] - mean - round_shift(t[i] * share_q16, 16);
    const size_t at = i / kArea * 2 * kArea + axis * kArea + i % kArea;
    h[at] = static_cast<int16_t>(std::clamp<int64_t>(free, -flow_kernel::kMaxGradient, flow_kernel::kMaxGradient));
  }
}

void FlowTemplates::learn_patch(const GreyView& picture, size_t number) {
  Patch& patch = patch_[number];
  const auto n = static_cast<size_t>(shape_.n_samples());
  int16_t* h = h_.data() + 2 * n * number;
  int16_t* t = t_.data() + n * number;
  int16_t* value = value_.data() + n * number;
  std::array<int32_t, kMaxBlocks * kArea> gx{};
  std::array<int32_t, kMaxBlocks * kArea> gy{};
  int64_t sum = 0;
  for (size_t i = 0; i < n; ++i) {
    const auto in_block = static_cast<int>(i % kArea);
    const int column = static_cast<int>(i / kArea) * kSide + in_block % kSide;
    const int16_t* at = picture.row(patch.y + in_block / kSide * shape_.row_step) + patch.x + column;
    gx[i] = (at[1] - at[-1]) >> 1;
    gy[i] = (at[picture.stride] - at[-picture.stride]) >> 1;
    value[i] = at[0];
    sum += at[0];
  }
  const int64_t mean = div_round(sum, static_cast<int64_t>(n));
  patch.tt = patch.t_sum = 0;
  for (size_t i = 0; i < n; ++i) {
    t[i] = static_cast<int16_t>(value[i] - mean);
    patch.tt += int64_t{t[i]} * t[i];
    patch.t_sum += t[i];
  }
  remove_nuisances(gx, t, patch.tt, 0, h);
  remove_nuisances(gy, t, patch.tt, 1, h);
  invert(patch, gx, gy, h);
  patch.s0_x = patch.s0_y = 0;
  for (size_t i = 0; i < n; ++i) {
    const size_t at = i / kArea * 2 * kArea + i % kArea;
    patch.s0_x += int64_t{h[at]} * value[i];
    patch.s0_y += int64_t{h[at + kArea]} * value[i];
  }
}

// Computes K and the centre of texture.
void FlowTemplates::invert(Patch& patch, std::span<const int32_t> gx, std::span<const int32_t> gy,
                           const int16_t* h) const {
  const auto n = static_cast<size_t>(shape_.n_samples());
  int64_t xx = 0, xy = 0, yx = 0, yy = 0, total = 0, along_x = 0, along_y = 0;
  for (size_t i = 0; i < n; ++i) {
    const size_t at = i / kArea * 2 * kArea + i % kArea;
    const int64_t hx = h[at];
    const int64_t hy = h[at + kArea];
    xx += hx * gx[i];
    xy += hx * gy[i];
    yx += hy * gx[i];
    yy += hy * gy[i];
    const int64_t energy = std::max<int64_t>(hx * gx[i] + hy * gy[i], 0);
    total += energy;
    along_x += energy * static_cast<int64_t>(i / kArea * kSide + i % kSide);
    along_y += energy * static_cast<int64_t>(i % kArea / kSide) * shape_.row_step;
  }
  total = std::max<int64_t>(total, 1);
  patch.center = {static_cast<int32_t>((int64_t{patch.x} << 16) + (along_x << 16) / total),
                  static_cast<int32_t>((int64_t{patch.y} << 16) + (along_y << 16) / total)};
  patch.inverse = invert_flow({xx, xy, yx, yy}, kMinContrast * static_cast<int64_t>(n));
}

flow_kernel::Block FlowTemplates::block(const GreyView& picture, const Patch& patch, const FlowVector& u,
                                        int number) const {
  return block_at(picture, shape_, (int64_t{patch.x} << 16) + u.x_q16, (int64_t{patch.y} << 16) + u.y_q16, number);
}

void FlowTemplates::search(const GreyView& picture, std::span<FlowVector> u) const {
  for (size_t i = 0; i < patch_.size(); ++i) {
    const Patch& patch = patch_[i];
    const int16_t* value = value_.data() + i * kArea;
    int64_t best = INT64_MAX;
    for (int dy = -kSearchPx; dy <= kSearchPx; ++dy) {
      const int16_t* row = picture.row(patch.y + dy) + patch.x;
      for (int dx = -kSearchPx; dx <= kSearchPx; ++dx) {
        const flow_kernel::MisfitSums sums = kernel_.misfit(row + dx, picture.stride, value);
        const int64_t cost = sums.square - (int64_t{sums.value} * sums.value >> 6);
        if (cost >= best) continue;
        best = cost;
        u[i] = {dx * 65'536, dy * 65'536};
      }
    }
  }
}

void FlowTemplates::step(const GreyView& picture, std::span<FlowVector> u, std::span<uint8_t> is_cut) const {
  const auto n = static_cast<size_t>(shape_.n_samples());
  for (size_t i = 0; i < patch_.size(); ++i) {
    const Patch& patch = patch_[i];
    is_cut[i] = 0;
    if (patch.inverse.shift == 0) continue;
    int64_t x = -patch.s0_x;
    int64_t y = -patch.s0_y;
    for (int b = 0; b < shape_.n_blocks; ++b) {
      const auto sums =
          kernel_.gradient(block(picture, patch, u[i], b), h_.data() + 2 * (n * i + static_cast<size_t>(b) * kArea));
      x += sums.x;
      y += sums.y;
    }
    const auto way = [&](int64_t k_x, int64_t k_y) {
      const int64_t full = round_shift(k_x * x + k_y * y, patch.inverse.shift);
      if (full >= kMaxStep || full <= -kMaxStep) is_cut[i] = 1;
      return std::clamp<int64_t>(full, -kMaxStep, kMaxStep);
    };
    u[i].x_q16 -= static_cast<int32_t>(way(patch.inverse.k[0], patch.inverse.k[1]));
    u[i].y_q16 -= static_cast<int32_t>(way(patch.inverse.k[2], patch.inverse.k[3]));
  }
}

// `unexplained`: R, four for each squared grey level, below 2^22.
uint8_t FlowTemplates::quality_of(const Patch& patch, int64_t unexplained) const {
  if (patch.inverse.shift == 0) return 0;
  // K 2^-shift converts Q8 products to Q16 px, with a shift of at least 17: gain R 2^(14 - shift) is error^2 / 4, Q20.
  const int64_t gain = std::max<int64_t>(int64_t{patch.inverse.k[0]} + patch.inverse.k[3], 0);
  const int64_t error2_q20 =
      (gain * std::max<int64_t>(unexplained, 0) >> (patch.inverse.shift - 16)) / shape_.n_samples();
  return static_cast<uint8_t>(std::max<int64_t>(255 * kHalfError2 / (kHalfError2 + error2_q20), 1));
}

void FlowTemplates::compare(const GreyView& picture, std::span<const FlowVector> u, int threshold_1e3,
                            std::span<uint8_t> quality) const {
  const auto n = static_cast<size_t>(shape_.n_samples());
  const int64_t share = int64_t{threshold_1e3} * threshold_1e3;
  for (size_t i = 0; i < patch_.size(); ++i) {
    int64_t value = 0, square = 0, product = 0;
    for (int b = 0; b < shape_.n_blocks; ++b) {
      const auto sums =
          kernel_.correlation(block(picture, patch_[i], u[i], b), t_.data() + n * i + static_cast<size_t>(b) * kArea);
      value += sums.value;
      square += sums.square;
      product += sums.product;
    }
    // Below 2^31 each; dropping a quarter of a squared grey level per sample keeps all products below 2^63.
    const int64_t spread = (square - value * value / static_cast<int64_t>(n)) >> 10;
    // t does not sum to zero exactly, because its mean was rounded.
    const int64_t common = (product - floor_div(value * patch_[i].t_sum, static_cast<int64_t>(n))) >> 10;
    const int64_t tt = patch_[i].tt >> 10;
    const bool is_alike = common > 0 && common * common * 1'000'000 >= share * tt * spread;
    quality[i] = is_alike && tt > 0 ? quality_of(patch_[i], spread - common * common / tt) : uint8_t{0};
  }
}

}  // namespace ruffini
