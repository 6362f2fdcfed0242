#include "image/taxels.h"

#include <algorithm>

#include "base/fixed.h"

namespace ruffini {
namespace {

constexpr int64_t kMaxRuns = 1'000'000;
constexpr uint32_t kMaxRunPixels = 1 << 17;  // pixels of one taxel or patch: 2^17 x 8160 fits 31 bits

Error bad(const std::string& what) {
  return {ErrorKind::kBadInput,
          "calibration file: skin." + what + ": make it again with `ruffini cal fit --only skin`"};
}

}  // namespace

Result<Taxels> Taxels::load(const Calibration& calibration, const BoardSettings& board) {
  const auto n_taxels = calibration.integer("skin.taxels", 1, kMaxTaxels);
  if (!n_taxels) return n_taxels.error();
  const auto n_patches = calibration.integer("skin.patches", 0, kMaxTaxels);
  if (!n_patches) return n_patches.error();
  const auto n_runs = calibration.integer("skin.runs", 1, kMaxRuns);
  if (!n_runs) return n_runs.error();
  const auto runs = calibration.tensor("skin.run", Tensor::Type::kI32, {n_runs.value(), 3});
  if (!runs) return runs.error();
  const auto light = calibration.tensor("skin.light", Tensor::Type::kI32, {n_taxels.value()});
  if (!light) return light.error();
  Taxels out;
  out.n_taxels_ = static_cast<size_t>(n_taxels.value());
  const size_t n = out.n_taxels_ + static_cast<size_t>(n_patches.value());
  const int64_t n_image = int64_t{board.camera.width_px} * board.camera.height_px;
  out.n_pixels_.resize(n);
  for (size_t i = 0; i < static_cast<size_t>(n_runs.value()); ++i) {
    const int32_t* const r = runs.value()->as<int32_t>().data() + 3 * i;
    if (r[0] < 0 || r[1] < 1 || int64_t{r[0]} + r[1] > n_image || r[2] < 0 || static_cast<size_t>(r[2]) >= n) {
      return bad("run leads outside the image or names no taxel");
    }
    out.runs_.push_back({static_cast<uint32_t>(r[0]), static_cast<uint32_t>(r[1]), static_cast<uint32_t>(r[2])});
    int32_t& pixels = out.n_pixels_[static_cast<size_t>(r[2])];
    if (r[1] > static_cast<int32_t>(kMaxRunPixels) - pixels) return bad("run gives a taxel more than 131072 pixels");
    pixels += r[1];
  }
  if (std::find(out.n_pixels_.begin(), out.n_pixels_.end(), 0) != out.n_pixels_.end()) {
    return bad("run leaves a taxel without pixels");
  }
  const auto calibrated = light.value()->as<int32_t>();
  if (*std::min_element(calibrated.begin(), calibrated.end()) < 1) return bad("light of a taxel is not above zero");
  out.calibrated_.assign(calibrated.begin(), calibrated.end());
  out.sum_.resize(n);
  out.base_.resize(out.n_taxels_, 1);
  out.ratio_.resize(out.n_taxels_);
  out.sorted_.resize(out.n_taxels_);
  return out;
}

void Taxels::sum(std::span<const int16_t> plane) {
  std::fill(sum_.begin(), sum_.end(), 0);
  for (const Run& run : runs_) {
    const int16_t* const at = plane.data() + run.first;
    int32_t total = 0;
    for (uint32_t i = 0; i < run.length; ++i) total += at[i];
    sum_[run.number] += total;
  }
}

int64_t Taxels::median(std::span<const int32_t> values) {
  std::copy(values.begin(), values.end(), sorted_.begin());
  const auto middle = sorted_.begin() + static_cast<ptrdiff_t>(sorted_.size() / 2);
  std::nth_element(sorted_.begin(), middle, sorted_.end());
  return *middle;
}

void Taxels::learn(std::span<const int16_t> base) {
  sum(base);
  for (size_t i = 0; i < n_taxels_; ++i) {
    base_[i] = std::max(sum_[i], 1);
    const int64_t age = floor_div(kOne * base_[i], calibrated_[i]);
    ratio_[i] = static_cast<int32_t>(std::min(age, kMaxChange));
  }
  age_q12_ = median(ratio_);
}

void Taxels::run(std::span<const int16_t> glow) {
  sum(glow);
  for (size_t i = 0; i < n_taxels_; ++i) {
    ratio_[i] = static_cast<int32_t>(std::clamp(floor_div(kOne * sum_[i], base_[i]), -kMaxChange, kMaxChange));
  }
  light_q12_ = std::max(median(ratio_), 1 - kOne);
  n_dark_ = 0;
  for (int32_t& ratio : ratio_) {
    const int64_t relative = floor_div(kOne * (ratio - light_q12_), kOne + light_q12_);
    ratio = static_cast<int32_t>(std::clamp(relative, -kMaxChange, kMaxChange));
    n_dark_ += static_cast<int>(2 * ratio < -kOne);
  }
  stray_q6_ = 0;
  for (size_t i = n_taxels_; i < sum_.size(); ++i) {
    const int64_t stray = floor_div(int64_t{16} * sum_[i], n_pixels_[i]);
    stray_q6_ = std::max({stray_q6_, stray, -stray});
  }
}

}  // namespace ruffini
