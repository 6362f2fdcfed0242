#include "image/rest.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr uint16_t kMinRest = 512;       // 32 grey levels
constexpr uint16_t kMaxRest = 16 * 255;  // a stored image may claim more
constexpr uint32_t kMaxReciprocal = 32'767;
constexpr int64_t kMax16 = 32'767;

}  // namespace

Rest::Rest(int width_px, int height_px, int n_frames)
    : width_px_(width_px),
      height_px_(height_px),
      n_frames_(n_frames),
      n_wanted_(n_frames),
      sum_(static_cast<size_t>(width_px * height_px * 3)),
      image_(sum_.size()),
      planes8_(sum_.size()),
      reciprocal_(sum_.size()),
      unit_reciprocal_(sum_.size()) {}

void Rest::restart(int n_frames) {
  n_wanted_ = n_frames > 0 ? n_frames : n_frames_;
  n_added_ = 0;
  is_ready_ = false;
  std::fill(sum_.begin(), sum_.end(), 0U);
}

void Rest::give_up() {
  if (is_ready_) return;
  restart(n_wanted_);
  is_ready_ = has_image_;
}

void Rest::load(std::span<const uint16_t> image) {
  std::copy(image.begin(), image.end(), image_.begin());
  finish();
}

void Rest::set_dark(std::span<const uint16_t> image) {
  dark_.assign(image.begin(), image.end());
  if (is_ready_) finish();
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
  const size_t n_pixels = image_.size() / 3;
  for (size_t i = 0; i < image_.size(); ++i) {
    const uint32_t divisor = std::max(static_cast<uint16_t>(image_[i] - dark(i)), kMinRest);
    unit_reciprocal_[i % 3 * n_pixels + i / 3] =
        static_cast<int16_t>(std::min(((uint32_t{1} << 24) + divisor / 2) / divisor, kMaxReciprocal));
  }
  set_gain(unit_gain());
  is_ready_ = true;
  has_image_ = true;
}

void Rest::set_gain(const Gain& gain) {
  const size_t n_pixels = image_.size() / 3;
  for (size_t c = 0; c < 3; ++c) {
    const int64_t inverse_q14 = ((int64_t{1} << 34) + gain[c] / 2) / gain[c];
    for (size_t i = 0; i < n_pixels; ++i) {
      const int64_t unlit = std::min(dark(3 * i + c), kMaxRest);
      const int64_t lit = std::min(image_[3 * i + c], kMaxRest) - unlit;
      const int64_t rest8 = 8 * unlit + ((8 * lit * gain[c] + kUnitGain / 2) >> 20);
      const int64_t reciprocal = (unit_reciprocal_[c * n_pixels + i] * inverse_q14 + (1 << 13)) >> 14;
      planes8_[c * n_pixels + i] = static_cast<int16_t>(std::min(rest8, kMax16));
      reciprocal_[c * n_pixels + i] = static_cast<int16_t>(std::min(reciprocal, kMax16));
    }
  }
}

}  // namespace ruffini
