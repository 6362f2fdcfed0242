// Threads that sleep until a number in memory changes, and their waking: one futex call each, no lock.
#pragma once

#include <linux/futex.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>

namespace ruffini {

// std::atomic::wait yields four times before it sleeps, which costs four more system calls per frame.
class Sleepers {
 public:
  // Sleeps until `word` is not `seen`. May return early, so the caller checks again.
  template <typename T>
  void sleep_while(const std::atomic<T>& word, T seen) {
    static_assert(sizeof(std::atomic<T>) == sizeof(uint32_t));  // the futex reads the number itself
    n_.fetch_add(1);
    ::syscall(SYS_futex, &word, FUTEX_WAIT_PRIVATE, seen, nullptr);
    n_.fetch_sub(1);
  }
  // Call after each change of the word, which must be sequentially consistent as all accesses are here: if this thread
  // does not see the sleeper's count, the sleeper sees the new value before it sleeps.
  template <typename T>
  void wake(const std::atomic<T>& word) const {
    if (n_.load() != 0) ::syscall(SYS_futex, &word, FUTEX_WAKE_PRIVATE, INT32_MAX);
  }

 private:
  std::atomic<int> n_{0};
};

}  // namespace ruffini
