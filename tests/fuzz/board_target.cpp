// libFuzzer: any bytes as board.toml.
#include "board/parse.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  (void)ruffini::parse_board({reinterpret_cast<const char*>(data), size}, "fuzz");
  return 0;
}
