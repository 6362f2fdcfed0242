// Formats text as JSON. Not for the core.
#pragma once

#include <string>

namespace ruffini {

// Adds quotes; control characters become spaces.
[[nodiscard]] inline std::string json_quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    out += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
  }
  return out + "\"";
}

}  // namespace ruffini
