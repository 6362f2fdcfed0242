#include "capture/camera.h"

namespace ruffini {

FramePool::FramePool(int n_buffers, int width_px, int height_px) : width_px_(width_px), height_px_(height_px) {
  for (int i = 0; i < n_buffers; ++i) {
    buffers_.push_back(std::make_unique<Buffer>());
    buffers_.back()->pixels.resize(static_cast<size_t>(width_px * height_px) * 3);
  }
}

std::optional<int> FramePool::lend() {
  for (size_t i = 0; i < buffers_.size(); ++i) {
    bool expected = false;
    if (buffers_[i]->is_lent.compare_exchange_strong(expected, true, std::memory_order_acq_rel)) {
      return static_cast<int>(i);
    }
  }
  return std::nullopt;
}

FrameView FramePool::view(int index) const {
  return {buffers_[static_cast<size_t>(index)]->pixels.data(), width_px_, height_px_, 3, ptrdiff_t{3} * width_px_};
}

}  // namespace ruffini
