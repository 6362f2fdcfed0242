// Where frames come from. The camera owns the pixels; a FrameLease lends one frame and gives it back.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "base/image_view.h"
#include "base/result.h"

namespace ruffini {

// Frame buffers of fixed size, lent out one by one. Any thread may give back.
class FramePool {
 public:
  FramePool(int n_buffers, int width_px, int height_px);

  struct Buffer {
    std::vector<uint8_t> pixels;  // B, G, R
    uint64_t capture_us = 0;      // mid-exposure, monotonic
    uint64_t number = 0;          // of the camera; gaps mean drops
    bool is_time_wrong = false;   // capture_us is that of arrival
    std::atomic<bool> is_lent{false};
  };

  // Index of a free buffer, now lent; nullopt when all are out.
  std::optional<int> lend();
  void give_back(int index) { buffers_[static_cast<size_t>(index)]->is_lent.store(false, std::memory_order_release); }
  Buffer& operator[](int index) { return *buffers_[static_cast<size_t>(index)]; }
  [[nodiscard]] FrameView view(int index) const;

 private:
  int width_px_;
  int height_px_;
  std::vector<std::unique_ptr<Buffer>> buffers_;
};

class FrameLease {
 public:
  FrameLease(FramePool& pool, int index) : pool_(&pool), index_(index) {}
  FrameLease(FrameLease&& other) noexcept : pool_(std::exchange(other.pool_, nullptr)), index_(other.index_) {}
  FrameLease& operator=(FrameLease&&) = delete;
  FrameLease(const FrameLease&) = delete;
  ~FrameLease() {
    if (pool_ != nullptr) pool_->give_back(index_);
  }

  [[nodiscard]] FrameView view() const { return pool_->view(index_); }
  [[nodiscard]] uint64_t capture_us() const { return (*pool_)[index_].capture_us; }
  [[nodiscard]] uint64_t number() const { return (*pool_)[index_].number; }
  [[nodiscard]] bool is_time_wrong() const { return (*pool_)[index_].is_time_wrong; }
  // Hands the buffer on without giving it back: the receiver makes its own lease.
  int release() {
    pool_ = nullptr;
    return index_;
  }

 private:
  FramePool* pool_;
  int index_;
};

// kNothing: no frame came in a while (a stalled camera); ask again.
enum class CaptureStatus { kFrame, kEnd, kInvalidFrame, kNothing };

class Camera {
 public:
  virtual ~Camera() = default;
  // Blocks until the next frame is due, though not for long, and writes it to `buffer`. Capture thread.
  virtual CaptureStatus capture(FramePool::Buffer& buffer) = 0;
  // After kEnd: what went wrong, in one sentence; empty where the frames came to their proper end.
  [[nodiscard]] virtual std::string problem() const { return {}; }
  [[nodiscard]] virtual bool is_simulated() const = 0;
  [[nodiscard]] virtual bool is_replay() const = 0;
};

}  // namespace ruffini
