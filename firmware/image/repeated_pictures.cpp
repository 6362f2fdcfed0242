#include "image/repeated_pictures.h"

#include <algorithm>
#include <bit>
#include <cstring>

namespace ruffini {
namespace {

static_assert(std::endian::native == std::endian::little);

constexpr int kBlock = 8;  // compression loses rows in blocks of this size
constexpr int kMaxBands = 30;
constexpr int kChannels = 3;
constexpr uint32_t kBlack = 2;  // mean grey levels that can repeat without a fault, at or below, and above
constexpr uint32_t kWhite = 253;
constexpr uint64_t kMix = 0x9E3779B97F4A7C15;  // 2^64 over the golden ratio: odd, and diffuses every bit upwards

}  // namespace

RepeatedPictures::RepeatedPictures(int width_px, int height_px)
    : band_rows_((height_px + kBlock * kMaxBands - 1) / (kBlock * kMaxBands) * kBlock),
      n_bands_(std::max(height_px / band_rows_, 1)) {
  band_rows_ = std::min(band_rows_, height_px);
  uint32_t lot = 1;
  const auto draw = [&](int n) {
    const int drawn = static_cast<int>(lot >> 16) % n;
    lot = lot * 1'103'515'245 + 12'345;
    return drawn;
  };
  const int wide = width_px / kColumns;
  for (int cell = 0; cell < n_bands_ * kColumns; ++cell) {
    const int left = cell % kColumns * wide;
    const int top = cell / kColumns * band_rows_;
    at_.push_back({kChannels * left, top});  // covers the picture's first pixel, too
    for (size_t i = 1; i < kSamples; ++i) {
      const int x = left + draw(wide);
      at_.push_back({kChannels * x, top + draw(band_rows_)});
    }
  }
  offset_.resize(at_.size());
  now_.resize(static_cast<size_t>(n_bands_ * kColumns));
  is_quiet_.resize(now_.size());
  before_.assign(kRemembered, now_);
}

void RepeatedPictures::begin_rest() {
  repeats_itself_.reset();
  std::fill(is_quiet_.begin(), is_quiet_.end(), uint8_t{0});
}

bool RepeatedPictures::run(const FrameView& frame) {
  sum(frame);
  last_ = compare();
  if (last_.most == 1 && repeats_itself_.has_value()) is_quiet_[last_.cell] = 1;
  remember();
  return last_.is_whole || (!repeats_itself_.value_or(true) && last_.most >= kMinCells);
}

void RepeatedPictures::sum(const FrameView& frame) {
  if (frame.stride != stride_) {
    stride_ = frame.stride;
    std::transform(at_.begin(), at_.end(), offset_.begin(), [&](const auto& at) { return at[1] * stride_ + at[0]; });
  }
  auto offset = offset_.begin();
  for (uint32_t& cell : now_) {
    uint32_t blue_red = 0;  // sums in 16 bits each
    uint32_t green = 0;     // times 256
    uint64_t mixed = 0;
    for (size_t i = 0; i < kSamples; ++i, ++offset) {
      const uint8_t* pixel = frame.data + *offset;
      uint16_t low = 0;
      std::memcpy(&low, pixel, sizeof(low));
      const uint32_t levels = uint32_t{low} | uint32_t{pixel[2]} << 16;
      blue_red += levels & 0xff00ff;
      green += levels & 0x00ff00;
      mixed = (mixed + levels + 1) * kMix;
    }
    const uint32_t level = (blue_red & 0xffff) + (blue_red >> 16) + (green >> 8);
    const bool shows_something = level > 3 * kSamples * kBlack && level < 3 * kSamples * kWhite;
    cell = shows_something ? std::max(static_cast<uint32_t>(mixed >> 32), 1U) : 0;
  }
}

RepeatedPictures::Repeats RepeatedPictures::compare() const {
  Repeats found{.n_older = n_before_};
  const auto n_shown = std::count_if(now_.begin(), now_.end(), [](uint32_t hash) { return hash != 0; });
  for (size_t k = 0; k < n_before_; ++k) {
    const Cells& older = before_[k];
    int n = 0;
    if (n_shown == std::ssize(now_)) {  // vector code
      for (size_t i = 0; i < now_.size(); ++i) n += now_[i] == older[i] ? 1 : 0;
    } else {
      for (size_t i = 0; i < now_.size(); ++i) n += now_[i] != 0 && now_[i] == older[i] ? 1 : 0;
    }
    if (n > found.most) count_loud(older, found);
    found.is_whole = found.is_whole || (n > 0 && n == n_shown);
  }
  return found;
}

void RepeatedPictures::count_loud(const Cells& older, Repeats& found) const {
  int n = 0;
  size_t cell = 0;
  for (size_t i = 0; i < now_.size(); ++i) {
    if (now_[i] == 0 || now_[i] != older[i] || is_quiet_[i] != 0) continue;
    ++n;
    cell = i;
  }
  if (n <= found.most) return;
  found.most = n;
  found.cell = cell;
}

void RepeatedPictures::remember() {
  before_[next_].swap(now_);
  next_ = (next_ + 1) % kRemembered;
  n_before_ = std::min(n_before_ + 1, kRemembered);
}

}  // namespace ruffini
