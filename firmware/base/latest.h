// The newest value from one thread to another: three copies, one atomic, no lock and no wait.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>

namespace ruffini {

// One thread writes, one reads. What the reader never took is replaced.
template <typename T>
class Latest {
 public:
  // Writer: fill this, then publish().
  [[nodiscard]] T& draft() { return copy_[back_]; }
  void publish() { back_ = middle_.exchange(back_ | kFresh, std::memory_order_acq_rel) & kIndex; }

  // Reader: what was published since the last call, or nullptr; it holds until the next call.
  [[nodiscard]] const T* take() {
    if ((middle_.load(std::memory_order_relaxed) & kFresh) == 0) return nullptr;
    front_ = middle_.exchange(front_, std::memory_order_acq_rel) & kIndex;
    return &copy_[front_];
  }

 private:
  static constexpr uint8_t kIndex = 3;
  static constexpr uint8_t kFresh = 4;
  std::array<T, 3> copy_{};
  uint8_t back_ = 0;                // the writer's
  uint8_t front_ = 1;               // the reader's
  std::atomic<uint8_t> middle_{2};  // between them
};

}  // namespace ruffini
