// Protocol Buffers on the wire, as far as ruffini.proto uses them; and Dense.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ruffini/client/decoder.h"

namespace ruffini::client {

// Fields of one message, one after the other. What is not protobuf, or has another wire type than was asked for, ends the
// reading: ok() is false then, and what was read is not to be used.
class Reader {
 public:
  Reader(const uint8_t* bytes, size_t n) : at_(bytes), end_(bytes + n) {}

  // Goes to the next field; false at the end.
  bool next();
  [[nodiscard]] uint32_t number() const { return number_; }
  [[nodiscard]] bool ok() const { return is_ok_; }
  void refuse() { is_ok_ = false; }

  [[nodiscard]] uint64_t u64();
  // Of 32 bits: what is beyond them is cut off, as protobuf has it.
  [[nodiscard]] uint32_t u32() { return static_cast<uint32_t>(u64()); }
  [[nodiscard]] int32_t s32();
  [[nodiscard]] int64_t s64();
  [[nodiscard]] std::string text();
  [[nodiscard]] Reader message();
  void bytes(const uint8_t*& bytes, size_t& n);  // they live as long as what is read
  // Adds to a repeated varint, packed or not; refuses more than `limit`.
  void repeated(std::vector<uint64_t>& out, size_t limit);

 private:
  uint64_t varint();
  const uint8_t* at_;
  const uint8_t* end_;
  const uint8_t* bytes_ = nullptr;  // of a field with a length
  size_t n_bytes_ = 0;
  uint64_t value_ = 0;
  uint32_t number_ = 0;
  uint32_t wire_type_ = 0;
  bool is_ok_ = true;
};

[[nodiscard]] inline int64_t unzigzag(uint64_t v) {
  return static_cast<int64_t>(v >> 1) ^ -static_cast<int64_t>(v & 1);
}

// Nodes of a Dense message; false unless the data holds exactly what the sizes say.
[[nodiscard]] bool read_grid(Reader reader, Grid& out);

// The message of a packet; false where it is not what ruffini.proto says.
[[nodiscard]] bool read_message(Type type, const std::vector<uint8_t>& payload, Message& out);

}  // namespace ruffini::client
