#include "stages/softness/softness.h"

#include <algorithm>
#include <array>
#include <functional>
#include <numeric>

#include "base/fixed.h"
#include "base/log2.h"
#include "solve/node_sigma.h"

namespace ruffini {
namespace {

constexpr int32_t kMaxForceUn = 1 << 30;
constexpr int32_t kMaxLog = 1 << 22;  // 64 octaves
constexpr int32_t kMaxSlope = 2 << 16;
constexpr int32_t kMaxSigma = 8 << 16;
constexpr int32_t kMaxGelPa = 1'000'000'000;
constexpr int64_t kMaxPa = 4'000'000'000;
constexpr int64_t kMaxRelative = 1 << 16;
constexpr int64_t kPerOctave = 94'548;  // 1 / ln 2, Q16
constexpr int64_t kOne = 1 << 16;
constexpr int64_t kMaxFeature = 1 << 19;  // eight times the light at rest: what a change can hold
constexpr int64_t kMaxFrames = 1 << 20;
static_assert(static_cast<int64_t>(Softness::kBlocks) * Softness::kChannels * 2 * (4 * kMaxFeature) *
                  (4 * kMaxFeature) <
              int64_t{1} << 62);

// 2^x in Q16 for x <= 0, Q16.
int64_t exp2_q16(int64_t x) {
  // 2^(1/2), 2^(1/4), ... 2^(1/65536), Q30.
  constexpr std::array<int64_t, 16> kRoots = {1'518'500'250, 1'276'901'417, 1'170'923'762, 1'121'280'436,
                                              1'097'253'708, 1'085'434'106, 1'079'572'136, 1'076'653'033,
                                              1'075'196'443, 1'074'468'888, 1'074'105'294, 1'073'923'544,
                                              1'073'832'680, 1'073'787'251, 1'073'764'537, 1'073'753'181};
  const int64_t whole = x >> 16;
  const int64_t part = x & 0xffff;
  int64_t out = int64_t{1} << 30;
  for (size_t i = 0; i < kRoots.size(); ++i) {
    if ((part >> (15 - i) & 1) != 0) out = out * kRoots[i] >> 30;
  }
  return whole < -30 ? 0 : out >> (14 - whole);
}

}  // namespace

Result<Softness> Softness::load(const Calibration& calibration, GridSize cells) {
  const auto map = calibration.tensor("softness.map", Tensor::Type::kI32, {6});
  if (!map) return map.error();
  const int n_blocks_x = std::max(cells.n_x - 2 * kRim - 1, 0);
  const int n_blocks_y = std::max(cells.n_y - 2 * kRim - 1, 0);
  const auto m = map.value()->as<int32_t>();
  const auto is_within = [&](size_t i, int32_t low, int32_t high) { return m[i] >= low && m[i] <= high; };
  if (!is_within(0, 1, kMaxForceUn) || !is_within(1, m[0], kMaxForceUn) || !is_within(2, 0, kMaxSlope) ||
      !is_within(3, -kMaxLog, kMaxLog) || !is_within(4, 1, kMaxSigma) || !is_within(5, 1, kMaxGelPa)) {
    return Error{ErrorKind::kBadInput, "calibration file: a number of softness.map is out of range: make it again"};
  }
  if (static_cast<size_t>(n_blocks_x) * static_cast<size_t>(n_blocks_y) < kBlocks) {
    return Error{ErrorKind::kBadInput,
                 "calibration file: softness needs a [picture_features] grid of at least 8 x 7 cells: give the board a "
                 "finer grid, or leave the table out"};
  }
  Softness out;
  out.cells_ = cells;
  out.low_un_ = m[0];
  out.high_un_ = m[1];
  out.slope_ = m[2];
  out.rigid_ = m[3];
  out.sigma_ = m[4];
  out.gel_pa_ = m[5];
  out.block_.resize(static_cast<size_t>(n_blocks_x) * static_cast<size_t>(n_blocks_y));
  return out;
}

int64_t Softness::dent(std::span<const int32_t> features) {
  const auto stride = static_cast<size_t>(cells_.n_x);
  const size_t plane = features.size() / kChannels;
  std::fill(block_.begin(), block_.end(), 0);
  for (int channel = 0; channel < kChannels; ++channel) {
    const auto f = features.subspan(static_cast<size_t>(channel) * plane, plane);
    auto block = block_.begin();
    for (int y = kRim; y + 1 < cells_.n_y - kRim; ++y) {
      for (int x = kRim; x + 1 < cells_.n_x - kRim; ++x) {
        const size_t at = static_cast<size_t>(y) * stride + static_cast<size_t>(x);
        const auto value = [&](size_t i) { return std::clamp<int64_t>(f[i], -kMaxFeature, kMaxFeature); };
        const int64_t down = value(at + stride + 1) - value(at);
        const int64_t up = value(at + 1) - value(at + stride);
        // (down + up)^2 + (down - up)^2: twice the slope along x, and along y
        *block++ += 2 * (down * down + up * up);
      }
    }
  }
  const auto last = block_.begin() + static_cast<std::ptrdiff_t>(kBlocks);
  std::partial_sort(block_.begin(), last, block_.end(), std::greater<>());
  const int64_t sum = std::accumulate(block_.begin(), last, int64_t{0});
  return log2_q16(static_cast<uint64_t>(sum / static_cast<int64_t>(kBlocks) + 1));
}

void Softness::run(std::span<const int32_t> features, int64_t force_un, int64_t sigma_un) {
  if (phase_ != Phase::kReleased && 2 * force_un < low_un_) {
    phase_ = Phase::kReleased;
    n_ = sum_ = sum_relative_ = 0;
  }
  if (phase_ == Phase::kReleased && force_un >= low_un_) phase_ = force_un < high_un_ ? Phase::kRising : Phase::kDone;
  if (phase_ != Phase::kRising || n_ >= kMaxFrames) return;
  const int64_t force = std::max<int64_t>(force_un, 1);
  ++n_;
  sum_ += (dent(features) >> 1) - round_shift(slope_ * log2_q16(static_cast<uint64_t>(force)), 16);
  sum_relative_ += std::min(sigma_un * kOne / force, kMaxRelative);
  if (force_un >= high_un_) finish();
}

void Softness::finish() {
  phase_ = Phase::kDone;
  const int64_t share = std::clamp<int64_t>(floor_div(sum_, n_) - rigid_, -kMaxLog, kMaxLog);
  const int64_t of_force = round_shift(round_shift(slope_ * (sum_relative_ / n_), 16) * kPerOctave, 16);
  const int64_t sigma = floor_sqrt(sigma_ * sigma_ + of_force * of_force);
  result_ = {.n_squeezes = result_.n_squeezes + 1,
             .n_frames = n_,
             .log_share_q16 = share,
             .log_sigma_q16 = sigma,
             .modulus_pa = share > kHardest ? 0 : modulus_pa(share),
             .low_pa = modulus_pa(std::min(share - sigma, kHardest)),
             .high_pa = share + sigma > kHardest ? 0 : modulus_pa(share + sigma)};
  n_ = sum_ = sum_relative_ = 0;
}

int64_t Softness::modulus_pa(int64_t log_share) const {
  const int64_t share = exp2_q16(log_share);
  return std::clamp<int64_t>(gel_pa_ * share / (kOne - share), 1, kMaxPa);
}

void Softness::discard_rise() {
  phase_ = Phase::kDone;
  n_ = sum_ = sum_relative_ = 0;
}

void Softness::forget() {
  phase_ = Phase::kReleased;
  n_ = sum_ = sum_relative_ = 0;
  result_ = {};
}

}  // namespace ruffini
