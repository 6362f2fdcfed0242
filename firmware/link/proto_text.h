// Copies text and bytes into nanopb's fixed-size fields.
#pragma once

#include <pb.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

namespace ruffini {

// Returns the length in bytes of the UTF-8 character at the start of `text` (RFC 3629: no overlong forms, no
// surrogates); 0 if it is invalid.
inline size_t utf8_bytes(std::string_view text) {
  const auto at = [&](size_t i) { return i < text.size() ? static_cast<uint8_t>(text[i]) : uint8_t{0}; };
  const uint8_t lead = at(0);
  if (lead < 0x80) return text.empty() ? 0 : 1;
  const size_t n = lead >= 0xC2 && lead <= 0xDF ? 2 : (lead & 0xF0) == 0xE0 ? 3 : lead >= 0xF0 && lead <= 0xF4 ? 4 : 0;
  for (size_t i = 1; i < n; ++i) {
    if ((at(i) & 0xC0) != 0x80) return 0;
  }
  const bool is_overlong = (lead == 0xE0 && at(1) < 0xA0) || (lead == 0xF0 && at(1) < 0x90);
  const bool is_beyond = (lead == 0xED && at(1) > 0x9F) || (lead == 0xF4 && at(1) > 0x8F);
  return is_overlong || is_beyond ? 0 : n;
}

// Truncates at a character boundary and replaces invalid bytes by '?': nanopb sends text unchecked, and hosts reject a
// message with invalid UTF-8.
template <size_t N>
void copy_text(char (&out)[N], const std::string& text) {
  size_t n = 0;
  for (std::string_view rest = text; !rest.empty();) {
    const size_t whole = utf8_bytes(rest);
    const size_t taken = std::max<size_t>(whole, 1);
    if (n + taken > N - 1) break;
    std::memcpy(out + n, whole == 0 ? "?" : rest.data(), taken);
    n += taken;
    rest.remove_prefix(taken);
  }
  out[n] = '\0';
}

// Makes text received from the line printable: invalid UTF-8 would spoil a message.
inline std::string to_plain_ascii(std::string text) {
  std::replace_if(text.begin(), text.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
  return text;
}

template <typename Bytes>
void copy_bytes(Bytes& out, const std::string& bytes) {
  out.size = static_cast<pb_size_t>(std::min(bytes.size(), sizeof out.bytes));
  std::memcpy(out.bytes, bytes.data(), out.size);
}

}  // namespace ruffini
