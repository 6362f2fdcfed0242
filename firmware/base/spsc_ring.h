// Byte messages from one thread to another: fixed memory, no lock; a message is stored completely or not at all.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

namespace ruffini {

// One producer thread calls push, one consumer thread calls pop. A message is stored as a u32 length and its bytes.
class SpscRing {
 public:
  // `capacity_bytes` must be a power of two.
  explicit SpscRing(size_t capacity_bytes) : storage_(capacity_bytes), mask_(capacity_bytes - 1) {}

  // Stores `head` and `body` as one message. Returns false, and stores nothing, if there is no room.
  bool push(std::span<const uint8_t> head, std::span<const uint8_t> body) {
    const size_t at = head_.load(std::memory_order_relaxed);
    const size_t used = at - tail_.load(std::memory_order_acquire);
    const size_t n_bytes = head.size() + body.size();
    if (sizeof(uint32_t) + n_bytes > storage_.size() - used) return false;
    const auto length = static_cast<uint32_t>(n_bytes);
    uint8_t prefix[sizeof length];
    std::memcpy(prefix, &length, sizeof length);
    write(at, prefix);
    write(at + sizeof length, head);
    write(at + sizeof length + head.size(), body);
    head_.store(at + sizeof length + n_bytes, std::memory_order_release);
    return true;
  }
  bool push(std::span<const uint8_t> message) { return push({}, message); }

  // Moves the next message to `out`, resized within its capacity. Returns false if there is none.
  bool pop(std::vector<uint8_t>& out) {
    return pop({}, [&out] { return &out; });
  }

  // The same, but the message's first bytes go to `head`, and then the others to the vector that `choose` returns.
  template <typename Choose>
  bool pop(std::span<uint8_t> head, Choose choose) {
    const size_t tail = tail_.load(std::memory_order_relaxed);
    if (tail == head_.load(std::memory_order_acquire)) return false;
    uint8_t prefix[sizeof(uint32_t)];
    read(tail, prefix);
    uint32_t length = 0;
    std::memcpy(&length, prefix, sizeof length);
    read(tail + sizeof length, head);
    std::vector<uint8_t>& out = *choose();
    out.resize(length - head.size());
    read(tail + sizeof length + head.size(), out);
    tail_.store(tail + sizeof length + length, std::memory_order_release);
    return true;
  }

 private:
  void write(size_t at, std::span<const uint8_t> bytes) {
    if (bytes.empty()) return;  // data() of an empty span may be null
    const size_t begin = at & mask_;
    const size_t first = std::min(bytes.size(), storage_.size() - begin);
    std::memcpy(storage_.data() + begin, bytes.data(), first);
    if (first < bytes.size()) std::memcpy(storage_.data(), bytes.data() + first, bytes.size() - first);
  }
  void read(size_t at, std::span<uint8_t> bytes) const {
    if (bytes.empty()) return;
    const size_t begin = at & mask_;
    const size_t first = std::min(bytes.size(), storage_.size() - begin);
    std::memcpy(bytes.data(), storage_.data() + begin, first);
    if (first < bytes.size()) std::memcpy(bytes.data() + first, storage_.data(), bytes.size() - first);
  }

  std::vector<uint8_t> storage_;
  size_t mask_;
  std::atomic<size_t> head_{0};
  std::atomic<size_t> tail_{0};
};

}  // namespace ruffini
