// libFuzzer: any bytes as board.toml, as settings and as JSON.
#include <cstdlib>

#include "board/parse.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const bool is_board = ruffini::parse_board(text, "fuzz").has_value();
  if (ruffini::board_json(text, "fuzz").has_value() != is_board) std::abort();
  return 0;
}
