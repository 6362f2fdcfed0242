#include "image/rest.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr uint16_t kMinRest = 512;  // 32 grey levels

}  // namespace

Rest::Rest(int width_px, int height_px, int n_frames)
    : width_px_(width_px),
      height_px_(height_px),
      n_frames_(n_frames),
      n_wanted_(n_frames),
      sum_(static_cast<size_t>(width_px * height_px * 3)),
      image_(sum_.size()),
      reciprocal_(sum_.size()) {}

void Rest::restart(int n_frames) {
  n_wanted_ = n_frames > 0 ? n_frames : n_frames_;
  n_added_ = 0;
  is_ready_ = false;
  std::fill(sum_.begin(), sum_.end(), 0U);
}

void Rest::load(std::span<const uint16_t> image) {
  std::copy(image.begin(), image.end(), image_.begin());
  finish();
}

bool Rest::add(const FrameView& frame) {
  const size_t row_values = static_cast<size_t>(width_px_) * 3;
  for (int y = 0; y < height_px_; ++y) {
    const uint8_t* pixels = frame.row(y);
    uint32_t* sums = sum_.data() + static_cast<size_t>(y) * row_values;
    for (size_t i = 0; i < row_values; ++i) sums[i] += pixels[i];
  }
  if (++n_added_ < n_wanted_) return false;
  const auto n = static_cast<uint32_t>(n_added_);
  for (size_t i = 0; i < sum_.size(); ++i) image_[i] = static_cast<uint16_t>((16 * sum_[i] + n / 2) / n);
  finish();
  return true;
}

void Rest::finish() {
  for (size_t i = 0; i < image_.size(); ++i) {
    const uint64_t divisor = std::max(image_[i], kMinRest);
    reciprocal_[i] = static_cast<uint32_t>(((uint64_t{1} << 32) + divisor / 2) / divisor);
  }
  is_ready_ = true;
}

}  // namespace ruffini
