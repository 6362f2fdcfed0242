// A mailbox of one: the newest value wins, what it replaces goes back to whoever posted it.
#pragma once

#include <atomic>
#include <optional>

namespace ruffini {

// Holds the index of a buffer. Any thread may post, take or close; no lock.
class IndexMailbox {
 public:
  // Returns the index that nobody will take: the one that was replaced, or, once closed, `index` itself.
  std::optional<int> post(int index) {
    int seen = slot_.load(std::memory_order_acquire);
    do {
      if (seen == kClosed) return index;
    } while (!slot_.compare_exchange_weak(seen, index, std::memory_order_acq_rel));
    slot_.notify_all();
    return seen >= 0 ? std::optional<int>(seen) : std::nullopt;
  }

  std::optional<int> take() {
    int seen = slot_.load(std::memory_order_acquire);
    do {
      if (seen < 0) return std::nullopt;
    } while (!slot_.compare_exchange_weak(seen, kEmpty, std::memory_order_acq_rel));
    slot_.notify_all();
    return seen;
  }

  // No more posts; every wait returns from now on. Returns what nobody had taken.
  std::optional<int> close() {
    const int seen = slot_.exchange(kClosed, std::memory_order_acq_rel);
    slot_.notify_all();
    return seen >= 0 ? std::optional<int>(seen) : std::nullopt;
  }

  [[nodiscard]] bool is_closed() const { return slot_.load(std::memory_order_acquire) == kClosed; }
  // Waits until something is there / until it was taken; or until closed.
  void wait_full() const { slot_.wait(kEmpty, std::memory_order_acquire); }
  void wait_empty() const {
    for (int seen = slot_.load(std::memory_order_acquire); seen >= 0; seen = slot_.load(std::memory_order_acquire)) {
      slot_.wait(seen, std::memory_order_acquire);
    }
  }

 private:
  static constexpr int kEmpty = -1;
  static constexpr int kClosed = -2;
  std::atomic<int> slot_{kEmpty};
};

}  // namespace ruffini
