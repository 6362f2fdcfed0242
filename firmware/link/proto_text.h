// Text and bytes into nanopb's fields of fixed size.
#pragma once

#include <pb.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>

namespace ruffini {

// What does not fit is cut off, before a whole UTF-8 character: half a one would spoil the message.
template <size_t N>
void copy_text(char (&out)[N], const std::string& text) {
  size_t n = std::min(text.size(), N - 1);
  while (n > 0 && n < text.size() && (static_cast<uint8_t>(text[n]) & 0xC0) == 0x80) --n;
  std::memcpy(out, text.data(), n);
  out[n] = '\0';
}

// What came over the line, fit to be said: a text that is no UTF-8 would spoil the message.
inline std::string plain(std::string text) {
  std::replace_if(text.begin(), text.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
  return text;
}

template <typename Bytes>
void copy_bytes(Bytes& out, const std::string& bytes) {
  out.size = static_cast<pb_size_t>(std::min(bytes.size(), sizeof out.bytes));
  std::memcpy(out.bytes, bytes.data(), out.size);
}

}  // namespace ruffini
