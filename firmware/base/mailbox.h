// A mailbox of one: the newest value wins, what it replaces goes back to whoever posted it.
#pragma once

#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <optional>

namespace ruffini {

// Holds the index of a buffer. Any thread may post, take or close; no lock. Who waits sleeps at once, in one system call:
// std::atomic::wait gives its core away four times before it does, which is four calls more a frame.
class IndexMailbox {
 public:
  // Returns the index that nobody will take: the one that was replaced, or, once closed, `index` itself.
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

  // No more posts; every wait returns from now on. Returns what nobody had taken.
  std::optional<int> close() {
    const int seen = slot_.exchange(kClosed);
    wake();
    return seen >= 0 ? std::optional<int>(seen) : std::nullopt;
  }

  [[nodiscard]] bool is_closed() const { return slot_.load(std::memory_order_acquire) == kClosed; }
  // Waits until something is there / until it was taken; or until closed.
  void wait_full() const {
    while (slot_.load(std::memory_order_acquire) == kEmpty) sleep_while(kEmpty);
  }
  void wait_empty() const {
    for (int seen = slot_.load(std::memory_order_acquire); seen >= 0; seen = slot_.load(std::memory_order_acquire)) {
      sleep_while(seen);
    }
  }

 private:
  // Until the slot changes, or for no reason: who calls looks again.
  void sleep_while(int seen) const {
    n_waiting_.fetch_add(1);
    ::syscall(SYS_futex, &slot_, FUTEX_WAIT_PRIVATE, seen, nullptr);
    n_waiting_.fetch_sub(1);
  }
  // After a change of the slot. Sequentially consistent, as the change before it: who does not see the one who waits has
  // changed the slot before that one looks at it.
  void wake() {
    if (n_waiting_.load() != 0) ::syscall(SYS_futex, &slot_, FUTEX_WAKE_PRIVATE, INT32_MAX);
  }

  static constexpr int kEmpty = -1;
  static constexpr int kClosed = -2;
  std::atomic<int> slot_{kEmpty};
  static_assert(sizeof(std::atomic<int>) == sizeof(int));  // the kernel looks at the number itself
  mutable std::atomic<int> n_waiting_{0};
};

}  // namespace ruffini
