#include "board/plain_toml.h"

#include <algorithm>
#include <sstream>
#include <utility>

namespace ruffini {

Result<toml::table> parse_plain_toml(std::string_view text, const std::string& where) {
  // Plain ASCII: every file has one spelling, and toml++ 3.3 has undefined behaviour on some other characters.
  if (text.substr(0, 3) == "\xEF\xBB\xBF") {
    return Error{ErrorKind::kBadInput, where + ": starts with a byte-order mark: save it without one"};
  }
  const auto is_allowed = [](char c) { return c == '\t' || c == '\n' || c == '\r' || (c >= ' ' && c <= '~'); };
  if (const auto odd = std::find_if_not(text.begin(), text.end(), is_allowed); odd != text.end()) {
    const auto line = 1 + std::count(text.begin(), odd, '\n');
    return Error{ErrorKind::kBadInput, where + ":" + std::to_string(line) + ": a character that is not plain ASCII"};
  }
  toml::parse_result parsed = toml::parse(text);
  if (!parsed) {
    std::ostringstream what;
    what << where << ":" << parsed.error().source().begin.line << ": not TOML: " << parsed.error().description();
    return Error{ErrorKind::kBadInput, what.str()};
  }
  return std::move(parsed).table();
}

}  // namespace ruffini
