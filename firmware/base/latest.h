// Passes the newest value from one thread to another: three copies, one atomic, no lock, no wait.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>

namespace ruffini {

// One thread writes, one thread reads. A value that the reader has not taken is replaced by the next one.
template <typename T>
class Latest {
 public:
  // Writer: fill the draft, then call publish().
  [[nodiscard]] T& draft() { return copy_[back_]; }
  void publish() { back_ = middle_.exchange(back_ | kFresh, std::memory_order_acq_rel) & kIndex; }

  // Reader: returns the value published since the last call, or nullptr. The pointer is valid until the next call.
  [[nodiscard]] const T* take() {
    if ((middle_.load(std::memory_order_relaxed) & kFresh) == 0) return nullptr;
    front_ = middle_.exchange(front_, std::memory_order_acq_rel) & kIndex;
    return &copy_[front_];
  }

 private:
  static constexpr uint8_t kIndex = 3;
  static constexpr uint8_t kFresh = 4;
  std::array<T, 3> copy_{};
  uint8_t back_ = 0;                // the writer's copy
  uint8_t front_ = 1;               // the reader's copy
  std::atomic<uint8_t> middle_{2};  // the copy in between, and kFresh
};

}  // namespace ruffini
