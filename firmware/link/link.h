// The line to the host: bytes, in order, as many as it takes now. Never blocks but in wait(). Link thread only.
#pragma once

#include <cstdint>
#include <span>

namespace ruffini {

class Link {
 public:
  virtual ~Link() = default;
  // Bytes moved; 0 = nothing now; -1 = the line hung up (reopen() may bring it back).
  virtual int read(std::span<uint8_t> out) = 0;
  virtual int write(std::span<const uint8_t> bytes) = 0;
  // Until there is something to read or, where `is_writing`, room to write; at most so long.
  virtual void wait(bool is_writing, int timeout_ms) = 0;
  // Something that was written is still on its way to the host.
  [[nodiscard]] virtual bool has_unsent() const = 0;
  // After a hang-up: what the host before did not read is forgotten. True when the line is usable again.
  virtual bool reopen() = 0;
};

}  // namespace ruffini
