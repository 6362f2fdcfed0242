#include "image/rest.h"

#include <algorithm>

namespace ruffini {
namespace {

constexpr uint16_t kMinRest = 512;       // 32 grey levels
constexpr uint16_t kMaxRest = 16 * 255;  // a stored image may contain larger values
constexpr uint32_t kMaxReciprocal = 32'767;
constexpr int64_t kMax16 = 32'767;
constexpr int kMapFrames = 16;  // the step of a row is below 1/2048, smaller than any detectable slope

int32_t between(int32_t a, int32_t b, int part) {
  return ((Rest::kNodePx - part) * a + part * b + Rest::kNodePx / 2) >> 4;
}

}  // namespace

Rest::Rest(int width_px, int height_px, int n_frames)
    : width_px_(width_px),
      height_px_(height_px),
      n_frames_(n_frames),
      n_wanted_(std::min(n_frames, kMaxFrames)),
      image_(static_cast<size_t>(width_px * height_px * 3)),
      planes8_(image_.size()),
      reciprocal_(image_.size()),
      unit_reciprocal_(image_.size()),
      nodes_(map_nodes(width_px, height_px)),
      factor_(3 * static_cast<size_t>(nodes_.count()), kUnitGain),
      node_gain_(factor_.size()),
      node_inverse_q14_(factor_.size()),
      row_gain_(static_cast<size_t>(nodes_.n_x)),
      row_inverse_q14_(row_gain_.size()),
      next_row_(height_px) {}

void Rest::restart(int n_frames) {
  n_wanted_ = std::min(n_frames > 0 ? n_frames : n_frames_, kMaxFrames);
  n_added_ = 0;
  is_ready_ = false;
  std::fill(unit_reciprocal_.begin(), unit_reciprocal_.end(), uint16_t{0});
}

void Rest::cancel_learning() {
  if (is_ready_) return;
  restart(n_wanted_);
  if (has_image_) find_unit_reciprocals();
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
    uint16_t* sums = unit_reciprocal_.data() + static_cast<size_t>(y) * row_values;
    for (size_t i = 0; i < row_values; ++i) sums[i] += pixels[i];
  }
  if (++n_added_ < n_wanted_) return false;
  const auto n = static_cast<uint32_t>(n_added_);
  for (size_t i = 0; i < image_.size(); ++i) {
    image_[i] = static_cast<uint16_t>((16 * uint32_t{unit_reciprocal_[i]} + n / 2) / n);
  }
  finish();
  return true;
}

void Rest::finish() {
  find_unit_reciprocals();
  has_image_ = true;
  std::fill(factor_.begin(), factor_.end(), kUnitGain);
  set_gain(unit_gain());
}

void Rest::find_unit_reciprocals() {
  const size_t n_pixels = image_.size() / 3;
  for (size_t i = 0; i < image_.size(); ++i) {
    unit_reciprocal_[i % 3 * n_pixels + i / 3] = static_cast<uint16_t>(unit_reciprocal(i));
  }
  is_ready_ = true;
}

int32_t Rest::unit_reciprocal(size_t i) const {
  const uint32_t divisor = std::max(static_cast<uint16_t>(image_[i] - dark(i)), kMinRest);
  return static_cast<int32_t>(std::min(((uint32_t{1} << 24) + divisor / 2) / divisor, kMaxReciprocal));
}

void Rest::set_gain(const Gain& gain) {
  gain_ = gain;
  find_node_gains();
  take_rows(0, height_px_);
  next_row_ = height_px_;
}

void Rest::set_map(std::span<const int32_t> factor) {
  std::copy(factor.begin(), factor.end(), factor_.begin());
  find_node_gains();
  next_row_ = 0;
}

void Rest::advance() {
  if (next_row_ >= height_px_) return;
  const int to = std::min(next_row_ + (height_px_ + kMapFrames - 1) / kMapFrames, height_px_);
  take_rows(next_row_, to);
  next_row_ = to;
}

void Rest::find_node_gains() {
  const auto n = static_cast<size_t>(nodes_.count());
  for (size_t i = 0; i < factor_.size(); ++i) {
    const int64_t gain = (int64_t{gain_[i / n]} * factor_[i] + kUnitGain / 2) >> 20;
    node_gain_[i] = clamp_gain(gain);
    node_inverse_q14_[i] = static_cast<int32_t>(((int64_t{1} << 34) + node_gain_[i] / 2) / node_gain_[i]);
  }
}

void Rest::take_rows(int from, int to) {
  const auto n_x = static_cast<size_t>(nodes_.n_x);
  for (size_t c = 0; c < 3; ++c) {
    for (int y = from; y < to; ++y) {
      const size_t node = (c * static_cast<size_t>(nodes_.n_y) + static_cast<size_t>(y / kNodePx)) * n_x;
      for (size_t i = 0; i < n_x; ++i) {
        const size_t upper = node + i;
        const size_t lower = upper + n_x;
        row_gain_[i] = between(node_gain_[upper], node_gain_[lower], y % kNodePx);
        row_inverse_q14_[i] = between(node_inverse_q14_[upper], node_inverse_q14_[lower], y % kNodePx);
      }
      for (int x = 0; x < width_px_; x += kNodePx) take_cells(c, y, x);
    }
  }
}

// Interpolates the pixels of a row between two nodes.
void Rest::take_cells(size_t channel, int y, int first_x) {
  const auto left = static_cast<size_t>(first_x / kNodePx);
  const auto n = static_cast<size_t>(std::min(kNodePx, width_px_ - first_x));
  const auto at = static_cast<size_t>(y * width_px_ + first_x);
  const size_t in_plane = channel * (image_.size() / 3) + at;
  const uint16_t* image = &image_[3 * at + channel];
  const uint16_t* dark = dark_.empty() ? nullptr : &dark_[3 * at + channel];
  // 16 times the value at the pixel, plus one half.
  int32_t gain16 = kNodePx * row_gain_[left] + kNodePx / 2;
  int32_t inverse16 = kNodePx * row_inverse_q14_[left] + kNodePx / 2;
  const int32_t gain_step = row_gain_[left + 1] - row_gain_[left];
  const int32_t inverse_step = row_inverse_q14_[left + 1] - row_inverse_q14_[left];
  for (size_t i = 0; i < n; ++i) {
    const int64_t unlit = dark == nullptr ? 0 : std::min({dark[3 * i], image[3 * i], kMaxRest});
    const int64_t lit = std::min(image[3 * i], kMaxRest) - unlit;
    const int64_t rest8 = 8 * unlit + ((8 * lit * (gain16 >> 4) + kUnitGain / 2) >> 20);
    const int64_t unit = is_ready_ ? unit_reciprocal_[in_plane + i] : unit_reciprocal(3 * (at + i) + channel);
    const int64_t reciprocal = (unit * (inverse16 >> 4) + (1 << 13)) >> 14;
    planes8_[in_plane + i] = static_cast<int16_t>(std::min(rest8, kMax16));
    reciprocal_[in_plane + i] = static_cast<int16_t>(std::min(reciprocal, kMax16));
    gain16 += gain_step;
    inverse16 += inverse_step;
  }
}

}  // namespace ruffini
