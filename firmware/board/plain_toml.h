// Parses TOML from untrusted files as strictly as all readers of this project: plain ASCII, no byte-order mark.
#pragma once

#include <string>
#include <string_view>

#define TOML_EXCEPTIONS 0
#include <toml++/toml.h>

#include "base/result.h"

namespace ruffini {

// `where` names the file in messages. Errors: kBadInput with file and line.
[[nodiscard]] Result<toml::table> parse_plain_toml(std::string_view text, const std::string& where);

}  // namespace ruffini
