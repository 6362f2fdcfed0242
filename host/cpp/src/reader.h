// Decodes Protocol Buffers as far as ruffini.proto uses them, and Dense.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ruffini/client/decoder.h"

namespace ruffini::client {

// Iterates over the fields of one message. Invalid data, or a wire type other than requested, ends the iteration: ok()
// is then false, and the values read must not be used.
class Reader {
 public:
  Reader(const uint8_t* bytes, size_t n) : at_(bytes), end_(bytes + n) {}

  // Advances to the next field; returns false at the end.
  bool next();
  [[nodiscard]] uint32_t number() const { return number_; }
  [[nodiscard]] bool ok() const { return is_ok_; }
  void refuse() { is_ok_ = false; }

  [[nodiscard]] uint64_t u64();
  // 32-bit value; higher bits are dropped, as protobuf specifies.
  [[nodiscard]] uint32_t u32() { return static_cast<uint32_t>(u64()); }
  [[nodiscard]] int32_t s32();
  [[nodiscard]] int64_t s64();
  [[nodiscard]] std::string text();
  [[nodiscard]] Reader message();
  void bytes(const uint8_t*& bytes, size_t& n);  // they live as long as what is read
  // Appends a repeated varint field, packed or not; refuses more than `limit` values.
  void repeated(std::vector<uint64_t>& out, size_t limit);

 private:
  uint64_t varint();
  const uint8_t* at_;
  const uint8_t* end_;
  const uint8_t* bytes_ = nullptr;  // content of a length-delimited field
  size_t n_bytes_ = 0;
  uint64_t value_ = 0;
  uint32_t number_ = 0;
  uint32_t wire_type_ = 0;
  bool is_ok_ = true;
};

[[nodiscard]] inline int64_t unzigzag(uint64_t v) {
  return static_cast<int64_t>(v >> 1) ^ -static_cast<int64_t>(v & 1);
}

// Reads the nodes of a Dense message; returns false unless the data matches the sizes exactly.
[[nodiscard]] bool read_grid(Reader reader, Grid& out);

// Decodes the message of a packet; returns false if it is not valid by ruffini.proto.
[[nodiscard]] bool read_message(Type type, const std::vector<uint8_t>& payload, Message& out);

}  // namespace ruffini::client
