// Converts the text of board.toml to BoardSettings, or to JSON. Strict: an unknown, missing, mistyped or out-of-range
// key is an error.
#pragma once

#include <string>
#include <string_view>

#include "base/result.h"
#include "board/settings.h"

namespace ruffini {

// `where` names the file in messages. Errors: kBadInput with file, key and remedy.
[[nodiscard]] Result<BoardSettings> parse_board(std::string_view toml_text, const std::string& where);

// Returns the same file as JSON for programs in other languages: keys sorted, numbers as decimal integers, defaults of
// absent keys filled in (absent optional sections stay absent). Same errors.
[[nodiscard]] Result<std::string> board_json(std::string_view toml_text, const std::string& where);

// Reads FOLDER/board.toml and checks that [board] name equals the folder's name.
[[nodiscard]] Result<BoardSettings> load_board(const std::string& folder);

}  // namespace ruffini
