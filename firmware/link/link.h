// The line to the host: a byte stream that accepts as much as it can at once. Only wait() blocks. Link thread only,
// except wake().
#pragma once

#include <cstdint>
#include <span>

namespace ruffini {

class Link {
 public:
  virtual ~Link() = default;
  // Returns the number of bytes moved; 0: none at present; -1: the line hung up (reopen() may restore it).
  virtual int read(std::span<uint8_t> out) = 0;
  virtual int write(std::span<const uint8_t> bytes) = 0;
  // Waits until there is something to read or, if `is_writing`, room to write; at most timeout_ms.
  virtual void wait(bool is_writing, int timeout_ms) = 0;
  // Any thread: ends the current wait() or, if there is none, the next one. Makes one system call and never waits.
  virtual void wake() {}
  // True if written data is still on its way to the host.
  [[nodiscard]] virtual bool has_unsent() const = 0;
  // After a hang-up: discards data that the previous host has not read. Returns true if the line is usable again.
  virtual bool reopen() = 0;
};

}  // namespace ruffini
