// C door on one program (solve/block_program.h), for the bit-exact comparison with the numpy mirror.
#include <cstring>
#include <vector>

#include "solve/block_program.h"

extern "C" {

// Loads `<name>.*` of a calibration file and runs it on n_runs inputs, for the selected outputs (all where
// n_selected is 0). Returns 0, or 1 with the loader's sentence in `error` (256 bytes).
int program_run(const uint8_t* bytes, int64_t n_bytes, const char* name, int n_in, int n_out, const int16_t* u,
                int n_runs, const uint32_t* selected, int n_selected, int64_t* out, char* error) {
  std::vector<uint64_t> aligned((static_cast<size_t>(n_bytes) + 7) / 8);
  std::memcpy(aligned.data(), bytes, static_cast<size_t>(n_bytes));
  const auto say = [error](const std::string& text) {
    std::strncpy(error, text.c_str(), 255);
    return 1;
  };
  auto file =
      ruffini::Calibration::parse({reinterpret_cast<const uint8_t*>(aligned.data()), static_cast<size_t>(n_bytes)});
  if (!file) return say(file.error().message);
  auto program = ruffini::BlockProgram::load(file.value(), name, n_in, n_out);
  if (!program) return say(program.error().message);
  if (n_selected > 0) program.value().select({selected, static_cast<size_t>(n_selected)});
  for (int i = 0; i < n_runs; ++i) {
    program.value().run({u + size_t(i) * size_t(n_in), size_t(n_in)}, {out + size_t(i) * size_t(n_out), size_t(n_out)});
  }
  return 0;
}

}  // extern "C"
