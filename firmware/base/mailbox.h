// A mailbox of one: the newest value wins, what it replaces goes back to whoever posted it.
#pragma once

#include <atomic>
#include <optional>

namespace ruffini {

// Holds the index of a buffer. Any thread may post, any may take; no lock.
class IndexMailbox {
 public:
  static constexpr int kEmpty = -1;

  // Returns the index that nobody had taken, if there was one: a dropped frame.
  std::optional<int> post(int index) {
    const int replaced = slot_.exchange(index, std::memory_order_acq_rel);
    slot_.notify_all();
    return replaced >= 0 ? std::optional<int>(replaced) : std::nullopt;
  }

  std::optional<int> take() {
    const int index = slot_.exchange(kEmpty, std::memory_order_acq_rel);
    slot_.notify_all();
    return index >= 0 ? std::optional<int>(index) : std::nullopt;
  }

  // Waits until something is there (or wake() was called) / until it was taken.
  void wait_full() const { slot_.wait(kEmpty, std::memory_order_acquire); }
  void wait_empty() const {
    for (int seen = slot_.load(std::memory_order_acquire); seen >= 0; seen = slot_.load(std::memory_order_acquire)) {
      slot_.wait(seen, std::memory_order_acquire);
    }
  }
  // Lets a waiting thread go although there is nothing: it must look at its stop flag.
  void wake() {
    int expected = kEmpty;
    slot_.compare_exchange_strong(expected, kWoken, std::memory_order_acq_rel);
    slot_.notify_all();
  }

 private:
  static constexpr int kWoken = -2;
  std::atomic<int> slot_{kEmpty};
};

}  // namespace ruffini
