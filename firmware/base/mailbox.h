// Mailbox for one buffer: the newest one wins, and the one it replaces returns to the thread that posted.
#pragma once

#include <atomic>
#include <optional>

#include "base/sleepers.h"

namespace ruffini {

// Holds the index of a buffer. Any thread may post, take or close; there is no lock.
class IndexMailbox {
 public:
  // Returns the index that nobody will take: the replaced one or, after close(), `index` itself.
  std::optional<int> post(int index) {
    int seen = slot_.load(std::memory_order_acquire);
    do {
      if (seen == kClosed) return index;
    } while (!slot_.compare_exchange_weak(seen, index));
    sleepers_.wake(slot_);
    return seen >= 0 ? std::optional<int>(seen) : std::nullopt;
  }

  std::optional<int> take() {
    int seen = slot_.load(std::memory_order_acquire);
    do {
      if (seen < 0) return std::nullopt;
    } while (!slot_.compare_exchange_weak(seen, kEmpty));
    sleepers_.wake(slot_);
    return seen;
  }

  // Ends all waits and refuses further posts. Returns the index that had not been taken.
  std::optional<int> close() {
    const int seen = slot_.exchange(kClosed);
    sleepers_.wake(slot_);
    return seen >= 0 ? std::optional<int>(seen) : std::nullopt;
  }

  [[nodiscard]] bool is_closed() const { return slot_.load(std::memory_order_acquire) == kClosed; }
  // Wait until an index is posted, or until it is taken. Both return when the mailbox is closed.
  void wait_full() const {
    while (slot_.load(std::memory_order_acquire) == kEmpty) sleepers_.sleep_while(slot_, kEmpty);
  }
  void wait_empty() const {
    for (int seen = slot_.load(std::memory_order_acquire); seen >= 0; seen = slot_.load(std::memory_order_acquire)) {
      sleepers_.sleep_while(slot_, seen);
    }
  }

 private:
  static constexpr int kEmpty = -1;
  static constexpr int kClosed = -2;
  std::atomic<int> slot_{kEmpty};
  mutable Sleepers sleepers_;
};

}  // namespace ruffini
