// Source of frames. The camera owns the pixels; a FrameLease holds one frame and returns it.
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

// Frame buffers of fixed size, lent one by one. Any thread may return a buffer.
class FramePool {
 public:
  FramePool(int n_buffers, int width_px, int height_px);

  struct Buffer {
    std::vector<uint8_t> pixels;  // B, G, R
    uint64_t capture_us = 0;      // mid-exposure, monotonic
    uint64_t number = 0;          // camera's number; gaps mean dropped frames
    bool is_time_wrong = false;   // capture_us is the time of arrival
    std::atomic<bool> is_lent{false};
  };

  // Returns the index of a free buffer, which is now lent; nullopt if none is free.
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
  // Releases ownership without returning the buffer: the receiver creates its own lease.
  int release() {
    pool_ = nullptr;
    return index_;
  }

 private:
  FramePool* pool_;
  int index_;
};

// kNothing: no frame arrived within a while (a stalled camera); call again.
enum class CaptureStatus { kFrame, kEnd, kInvalidFrame, kNothing };

class Camera {
 public:
  virtual ~Camera() = default;
  // Waits a limited time for the next frame and writes it to `buffer`. Capture thread.
  virtual CaptureStatus capture(FramePool::Buffer& buffer) = 0;
  // After kEnd: the error in one sentence; empty for a normal end.
  [[nodiscard]] virtual std::string problem() const { return {}; }
  [[nodiscard]] virtual bool is_simulated() const = 0;
  [[nodiscard]] virtual bool is_replay() const = 0;
};

}  // namespace ruffini
