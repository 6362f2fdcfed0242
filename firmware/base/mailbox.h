// Mailbox for one buffer: the newest one wins, and the one it replaces returns to the thread that posted.
#pragma once

#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <optional>

namespace ruffini {

// Holds the index of a buffer. Any thread may post, take or close; there is no lock. A waiting thread sleeps at once,
// by one futex call: std::atomic::wait yields four times first, which costs four more system calls per frame.
class IndexMailbox {
 public:
  // Returns the index that nobody will take: the replaced one or, after close(), `index` itself.
  std::optional<int> post(int index) {
    int seen = slot_.load(std::memory_order_acquire);
    do {
      if (seen == kClosed) return index;
    } while (!slot_.compare_exchange_weak(seen, index));
    wake();
    return seen >= 0 ? std::optional<int>(seen) : std::nullopt;
  }

  std::optional<int> take() {
    int seen = slot_.load(std::memory_order_acquire);
    do {
      if (seen < 0) return std::nullopt;
    } while (!slot_.compare_exchange_weak(seen, kEmpty));
    wake();
    return seen;
  }

  // Ends all waits and refuses further posts. Returns the index that had not been taken.
  std::optional<int> close() {
    const int seen = slot_.exchange(kClosed);
    wake();
    return seen >= 0 ? std::optional<int>(seen) : std::nullopt;
  }

  [[nodiscard]] bool is_closed() const { return slot_.load(std::memory_order_acquire) == kClosed; }
  // Wait until an index is posted, or until it is taken. Both return when the mailbox is closed.
  void wait_full() const {
    while (slot_.load(std::memory_order_acquire) == kEmpty) sleep_while(kEmpty);
  }
  void wait_empty() const {
    for (int seen = slot_.load(std::memory_order_acquire); seen >= 0; seen = slot_.load(std::memory_order_acquire)) {
      sleep_while(seen);
    }
  }

 private:
  // Sleeps until the slot changes. May wake up spuriously, so the caller checks again.
  void sleep_while(int seen) const {
    n_waiting_.fetch_add(1);
    ::syscall(SYS_futex, &slot_, FUTEX_WAIT_PRIVATE, seen, nullptr);
    n_waiting_.fetch_sub(1);
  }
  // Call after each change of the slot. All accesses are sequentially consistent: if this thread does not see the
  // waiter's count, the waiter sees the new slot value before it sleeps.
  void wake() {
    if (n_waiting_.load() != 0) ::syscall(SYS_futex, &slot_, FUTEX_WAKE_PRIVATE, INT32_MAX);
  }

  static constexpr int kEmpty = -1;
  static constexpr int kClosed = -2;
  std::atomic<int> slot_{kEmpty};
  static_assert(sizeof(std::atomic<int>) == sizeof(int));  // the futex reads the number itself
  mutable std::atomic<int> n_waiting_{0};
};

}  // namespace ruffini
